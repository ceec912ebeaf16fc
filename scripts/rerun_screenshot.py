"""Make the picture of the README: the virtual Kinect in Rerun's web viewer, in a real browser.

    python -m scripts.rerun_screenshot docs/overview.jpg

It needs Debian's `chromium`. Exit code 1 if the picture has no trajectory or no camera image.
"""

import argparse
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

import cv2
import numpy as np

from vo_service.outputs.rerun.scene import TRAJECTORY_COLOR
from vo_service.outputs.rerun.sinks import LOOPBACK
from vo_service.outputs.rerun.web_viewer_server import (
    WebViewerServer,
    no_telemetry_environment,
    pick_free_port,
    rerun_binary,
    wait_for_port,
)

BROWSER = [
    "chromium",
    "--headless",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--window-size=1400,850",
]
PICTURE_WIDTH = 1000
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 82)
# Virtual time of the page; it runs ahead while the page compiles, depending on the computer.
PAGE_TIMES_MS = (30_000, 120_000, 480_000, 4_000_000)


def main() -> int:
    """Take the screenshot and check its content."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("picture", type=Path, help="file to write, .jpg or .png")
    picture = parser.parse_args().picture
    with tempfile.TemporaryDirectory() as folder:
        recording, screenshot = make_recording(Path(folder)), Path(folder) / "screenshot.png"
        for page_time_ms in PAGE_TIMES_MS:
            home = Path(folder) / str(page_time_ms)
            home.mkdir()
            take_screenshot(recording, screenshot, page_time_ms, home)
            problems = find_missing_content(screenshot)
            if not problems:
                break
        image = cv2.imread(str(screenshot))
    if image is not None:
        size = (PICTURE_WIDTH, image.shape[0] * PICTURE_WIDTH // image.shape[1])
        cv2.imwrite(str(picture), cv2.resize(image, size, interpolation=cv2.INTER_AREA), JPEG)
    print("\n".join(problems) or f"{picture}: trajectory and camera image are visible")
    return 1 if problems else 0


def make_recording(folder: Path) -> Path:
    """Replay ten seconds of the virtual Kinect with loop closure into a recording of Rerun."""
    frames, recording = folder / "room", folder / "room.rrd"
    for arguments in (
        ["record", "--camera", "synthetic", "--seconds", "10", str(frames)],
        ["replay", str(frames), "--no-publish", "--loop-closure", "--rerun", str(recording)],
    ):
        subprocess.run([Path(sys.executable).parent / "kinect-vo", *arguments], check=True)
    return recording


def take_screenshot(recording: Path, picture: Path, page_time_ms: int, home: Path) -> None:
    """Serve the recording on loopback and render it in a browser."""
    data_port, page_port = pick_free_port(), pick_free_port()
    command = [str(rerun_binary()), "--serve-grpc", "--bind", LOOPBACK, "--port", str(data_port)]
    data = subprocess.Popen([*command, str(recording)], env=no_telemetry_environment(home))
    try:
        wait_for_port(data_port)
        with closing(WebViewerServer(page_port, data_port)):
            url = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
            page = f"http://{LOOPBACK}:{page_port}/?url={url}&renderer=webgl"
            options = [f"--screenshot={picture.resolve()}", f"--user-data-dir={home}/browser"]
            options += [f"--virtual-time-budget={page_time_ms}"]
            subprocess.run(
                [*BROWSER, *options, page], check=True, stderr=subprocess.DEVNULL, timeout=300
            )
    finally:
        data.kill()
        data.wait()


def find_missing_content(picture: Path) -> list[str]:
    """List the missing parts of the screenshot."""
    image = cv2.imread(str(picture))
    if image is None:
        return [f"{picture}: the browser took no picture"]
    width = image.shape[1]
    below_the_bar = image[50:]
    scene, pictures = below_the_bar[:, : width // 2], below_the_bar[:, width // 2 :]
    trajectory = np.abs(scene.astype(int) - TRAJECTORY_COLOR[::-1]).max(axis=2) < 30
    problems = []
    if np.count_nonzero(trajectory) < 50:
        problems.append(f"{picture}: no trajectory in the 3-D view")
    if len(np.unique(pictures.reshape(-1, 3), axis=0)) < 2000:
        problems.append(f"{picture}: no camera image beside it")
    return problems


if __name__ == "__main__":
    sys.exit(main())

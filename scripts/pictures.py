"""Make the pictures of the documentation from ten seconds of the virtual Kinect.

    python -m scripts.pictures [FOLDER]        (default: docs/pictures)

overview.jpg is Rerun's web viewer, mcap.jpg the same with an MCAP file as it opens it, and
comparison.jpg the report of `kinect-vo compare`, in a real browser: Debian's `chromium`.
trajectory.png is the plot of `kinect-vo evaluate`, and reconstruction.jpg the room from above. Exit
code 1 if the viewer shows no trajectory, no depth or no image.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.outputs.loopback_ports import LOOPBACK, probe_port
from vo_service.outputs.rerun.scene import TRAJECTORY_COLOR
from vo_service.outputs.rerun.web_viewer_server import (
    WebViewerServer,
    no_telemetry_environment,
    rerun_binary,
    wait_for_port,
)

BROWSER = ["chromium", "--headless", "--no-sandbox"]
WEBGL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
PICTURE_WIDTH = 1000
JPEG = (cv2.IMWRITE_JPEG_QUALITY, 82)
# Virtual time of the page; it runs ahead while the page compiles, depending on the computer.
PAGE_TIMES_MS = (30_000, 120_000, 480_000, 4_000_000)


def main() -> int:
    """Make all pictures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("docs/pictures"))
    folder = parser.parse_args().folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        scratch = Path(name)
        room = scratch / "room"
        run("record", "--camera", "synthetic", "--seconds", "10", room)
        make_trajectory(room, folder / "trajectory.png")
        make_reconstruction(room, folder / "reconstruction.jpg")
        make_comparison(room, folder / "comparison.jpg")
        problems = make_overview(room, folder / "overview.jpg")
        problems += make_mcap_view(room, folder / "mcap.jpg")
    print("\n".join(problems) or f"{folder}: 5 pictures")
    return 1 if problems else 0


def run(*arguments: str | Path) -> None:
    """Run a command of kinect-vo."""
    subprocess.run([Path(sys.executable).parent / "kinect-vo", *arguments], check=True)


def make_trajectory(room: Path, picture: Path) -> None:
    """Plot the trajectory beside the ground truth."""
    trajectory = room.with_suffix(".txt")
    run("replay", room, "--no-publish", "--trajectory", trajectory)
    run("evaluate", trajectory, room, "--picture", picture)


def make_reconstruction(room: Path, picture: Path) -> None:
    """Show the mesh of the room from above."""
    run("reconstruct", room, "--output", room.parent / "map")
    save_small(room.parent / "map" / "top.png", picture)


def make_comparison(room: Path, picture: Path) -> None:
    """Show the first page of the report that compares the methods."""
    output, screenshot = room.parent / "comparison", room.parent / "comparison.png"
    run("compare", room, "--output", output)
    take_picture(f"file://{output}/report.html", screenshot, room.parent, "--window-size=1100,1250")
    save_small(screenshot, picture)


def make_overview(room: Path, picture: Path) -> list[str]:
    """Show a replay in Rerun; return what is missing in the picture."""
    recording = room.with_suffix(".rrd")
    run("replay", room, "--no-publish", "--loop-closure", "--rerun", recording)
    return take_complete_picture(recording, picture, find_missing_trajectory)


def make_mcap_view(room: Path, picture: Path) -> list[str]:
    """Show an MCAP file in Rerun, without any setting; return what is missing in the picture."""
    beginning, recording = room.parent / "beginning", room.with_suffix(".mcap")
    run(
        "record", "--camera", f"tum:{room}", "--seconds", "4", beginning
    )  # all is drawn by software
    run("replay", beginning, "--no-publish", "--mcap", recording)
    return take_complete_picture(recording, picture, find_missing_depth)


def take_complete_picture(
    recording: Path, picture: Path, find_missing: Callable[[NDArray[Any]], list[str]]
) -> list[str]:
    """Show a recording in Rerun, longer until nothing is missing; return what still is."""
    problems: list[str] = []
    for page_time_ms in PAGE_TIMES_MS:
        with tempfile.TemporaryDirectory() as home:
            screenshot = Path(home) / "screenshot.png"
            take_rerun_picture(recording, screenshot, page_time_ms, Path(home))
            image = cv2.imread(str(screenshot))
            problems = ["no screenshot"] if image is None else find_missing(image)
            save_small(screenshot, picture)
        if not problems:
            break
    return [f"{picture}: {each}" for each in problems]


def save_small(picture: Path, small: Path) -> None:
    """Save a picture as a JPEG of the documentation's width."""
    image = cv2.imread(str(picture))
    if image is not None:
        size = (PICTURE_WIDTH, image.shape[0] * PICTURE_WIDTH // image.shape[1])
        cv2.imwrite(str(small), cv2.resize(image, size, interpolation=cv2.INTER_AREA), JPEG)


def take_picture(page: str, picture: Path, home: Path, *options: str) -> None:
    """Render a page in a browser."""
    command = [*BROWSER, *options, f"--screenshot={picture}", f"--user-data-dir={home}/browser"]
    subprocess.run([*command, page], check=True, stderr=subprocess.DEVNULL, timeout=300)


def take_rerun_picture(recording: Path, picture: Path, page_time_ms: int, home: Path) -> None:
    """Serve the recording on loopback and render Rerun's web viewer."""
    data_port, page_port = probe_port(), probe_port()
    command = [str(rerun_binary()), "--serve-grpc", "--bind", LOOPBACK, "--port", str(data_port)]
    data = subprocess.Popen([*command, str(recording)], env=no_telemetry_environment(home))
    options = [*WEBGL, "--window-size=1400,850", f"--virtual-time-budget={page_time_ms}"]
    try:
        wait_for_port(data_port)
        with closing(WebViewerServer(page_port, data_port)):
            url = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
            page = f"http://{LOOPBACK}:{page_port}/?url={url}&renderer=webgl"
            take_picture(page, picture, home, *options)
    finally:
        data.kill()
        data.wait()


def find_missing_trajectory(image: NDArray[Any]) -> list[str]:
    """List the missing parts of the view that the service lays out."""
    width = image.shape[1]
    below_the_bar = image[50:]
    scene, pictures = below_the_bar[:, : width // 2], below_the_bar[:, width // 2 :]
    trajectory = np.abs(scene.astype(int) - TRAJECTORY_COLOR[::-1]).max(axis=2) < 30
    problems = ["no trajectory in the 3-D view"] if np.count_nonzero(trajectory) < 50 else []
    return problems + _find_missing_image(pictures)


def find_missing_depth(image: NDArray[Any]) -> list[str]:
    """List the missing parts of the view that Rerun lays out, with the 3-D view first."""
    views = image[62:640, 200:1100]
    saturation = cv2.cvtColor(views[:150, :250], cv2.COLOR_BGR2HSV)[:, :, 1]
    problems = ["no depth in the 3-D view"] if np.count_nonzero(saturation > 100) < 500 else []
    return problems + _find_missing_image(views[:, 250:])


def _find_missing_image(pixels: NDArray[Any]) -> list[str]:
    return [] if len(np.unique(pixels.reshape(-1, 3), axis=0)) > 2000 else ["no camera image"]


if __name__ == "__main__":
    sys.exit(main())

"""Time to the virtual Kinect's first pose and first picture with an empty cache.

    python -m benchmarks first_pose [--rounds 3]

"first pose" is from the start of `kinect-vo run --camera synthetic` until a client has a pose.
"first picture" is from the start of `kinect-vo demo` until its Rerun recording has an image. The
recording is written every two seconds, so the page shows the image up to two seconds sooner. Each
start has an empty cache folder: kernels are compiled by the setup, but no room is rendered.
"""

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.ports import free_port
from vo_service import PoseClient

KINECT_VO = Path(sys.executable).with_name("kinect-vo")
TIMEOUT_S = 300.0
POLL_PERIOD_S = 0.05
JPEG = b"\xff\xd8\xff"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--rounds", type=int, default=3, help="starts of each (default: 3)")


def main(args: argparse.Namespace) -> None:
    """Measure and print a line for each."""
    cases = {
        "first pose of run": _measure_first_pose_s,
        "first picture of demo": _measure_first_picture_s,
    }
    for name, measure in cases.items():
        taken_s = sorted(measure_start_s(measure) for _ in range(args.rounds))
        each = ", ".join(f"{seconds:.1f}" for seconds in taken_s)
        print(f"{name}: {statistics.median(taken_s):.1f} s (all: {each})")


def measure_start_s(measure: Callable[[Path, Path, int], float]) -> float:
    """Measure one start in an empty folder, with a configuration that uses a free port."""
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        config = folder / "kinect.toml"
        config.write_text(f'schema = 1\n[zenoh]\nlisten = ["tcp/127.0.0.1:{port}"]\n')
        return measure(folder, config, port)


def _measure_first_pose_s(folder: Path, config: Path, port: int) -> float:
    """Measure the seconds until a client has the first pose of the service."""
    begin_s = time.monotonic()
    with (
        running_command(folder, "run", "--camera", "synthetic", "--config", config),
        PoseClient(connect=f"tcp/127.0.0.1:{port}") as client,
    ):
        next(iter(client.poses(timeout_s=TIMEOUT_S)))
        return time.monotonic() - begin_s


def _measure_first_picture_s(folder: Path, config: Path, port: int) -> float:
    """Measure the seconds until the demo's recording has an image."""
    recording = folder / "demo" / "demo.rrd"
    begin_s = time.monotonic()
    with running_command(
        folder, "demo", "--config", config, "--output", recording.parent
    ) as process:
        while not (recording.exists() and JPEG in recording.read_bytes()):
            if process.poll() is not None or time.monotonic() - begin_s > TIMEOUT_S:
                raise RuntimeError("the demo recorded no image")
            time.sleep(POLL_PERIOD_S)
        return time.monotonic() - begin_s


@contextmanager
def running_command(folder: Path, *arguments: object) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a command with its own cache; end it at the end of the block."""
    caches = {"XDG_CACHE_HOME": folder / "cache", "XDG_STATE_HOME": folder / "state"}
    environment = os.environ | {name: str(path) for name, path in caches.items()}
    command = [str(part) for part in (KINECT_VO, *arguments)]
    devnull = subprocess.DEVNULL
    with subprocess.Popen(command, env=environment, stdout=devnull, stderr=devnull) as process:
        try:
            yield process
        finally:
            process.terminate()

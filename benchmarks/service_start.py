"""From the start of a command to its first pose or picture."""

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from statistics import median

from benchmarks.harness import option
from benchmarks.simulated_kinect import make_kinect
from tests.ports import free_port
from tests.vo_service.service_process import KINECT_VO
from tests.waiting import wait_until
from vo_service import PoseClient

START_TIMEOUT_S = 300.0
JPEG = b"\xff\xd8\xff"
# Measures a start in a folder, with a client of the service, on a recording.
StartCase = Callable[[Path, PoseClient, Path], float]


@option("recording", type=Path, help="folder in TUM format")
@option("--rounds", type=int, default=5, help="starts of each case (default: 5)")
@option("--case", help="only this case")
def main(args: argparse.Namespace) -> None:
    """Time to the first pose of a recording, of a Kinect and of the virtual one, and of the demo.

    "recording" and "virtual Kinect" are from the start of `kinect-vo run` until a client has a
    pose. "Kinect" is from the stamp of the frame of the first pose until a client has it, with a
    simulated Kinect. The service connects to the client, so that this misses none. "demo" is
    from the start of `kinect-vo demo` until its Rerun recording has an image; it is written every
    two seconds, so the page shows the image up to two seconds sooner. Each start has an empty cache
    folder: kernels are compiled by the setup, but no room is rendered.
    """
    for name, measure in CASES.items():
        if args.case in (None, name):
            taken_s = sorted(measure_start_s(measure, args.recording) for _ in range(args.rounds))
            each = ", ".join(f"{seconds:.2f}" for seconds in taken_s)
            print(f"{name}: {median(taken_s):.2f} s (all: {each})", flush=True)


def measure_start_s(measure: StartCase, recording: Path) -> float:
    """Measure one start in an empty folder, with a client that listens."""
    with tempfile.TemporaryDirectory() as name:
        folder, endpoints = Path(name), [f"tcp/127.0.0.1:{free_port()}" for _ in range(2)]
        own, reader = endpoints
        config, client_config = folder / "kinect.toml", folder / "client.json5"
        config.write_text(f'schema = 1\n[zenoh]\nlisten = ["{own}"]\nconnect = ["{reader}"]\n')
        client_config.write_text(json.dumps({"listen": {"endpoints": [reader]}}))
        with PoseClient(config_file=client_config) as client:
            return measure(folder, client, recording.absolute())


def first_pose_s(folder: Path, client: PoseClient, recording: Path, camera: str) -> float:
    """Measure the seconds from the start of the service to the first pose."""
    begin_s = time.monotonic()
    with running_command(
        folder, {}, "run", "--camera", camera.replace("RECORDING", f"{recording}")
    ):
        wait_for_pose(client)
        return time.monotonic() - begin_s


def first_pose_of_kinect_s(folder: Path, client: PoseClient, recording: Path) -> float:
    """Measure the seconds from the first frame of a simulated Kinect to its pose."""
    kinect = make_kinect(folder, recording)
    with kinect, running_command(folder, kinect.environment, "run", "--camera", "freenect"):
        stamp_s = wait_for_pose(client)
        return time.time() - stamp_s


def first_picture_of_demo_s(folder: Path, client: PoseClient, recording: Path) -> float:
    """Measure the seconds until the demo's Rerun file has an image."""
    file = folder / "demo" / "demo.rrd"
    begin_s = time.monotonic()
    with running_command(folder, {}, "demo", "--output", file.parent) as process:

        def has_picture() -> bool:
            assert process.poll() is None, "the demo has ended"
            return file.exists() and JPEG in file.read_bytes()

        wait_until(has_picture, "an image of the demo", timeout_s=START_TIMEOUT_S)
        return time.monotonic() - begin_s


def wait_for_pose(client: PoseClient) -> float:
    """Wait for the first pose; return its stamp."""
    return next(iter(client.poses(timeout_s=START_TIMEOUT_S))).stamp_s


@contextmanager
def running_command(
    folder: Path, variables: Mapping[str, str], *arguments: object
) -> Iterator["subprocess.Popen[bytes]"]:
    """Run a command with a cache and the configuration of a folder; end it at the end."""
    caches = {"XDG_CACHE_HOME": folder / "cache", "XDG_STATE_HOME": folder / "state"}
    environment = os.environ | variables | {name: str(path) for name, path in caches.items()}
    parts = (KINECT_VO, *arguments, "--config", folder / "kinect.toml")
    command = list(map(str, parts))
    devnull = subprocess.DEVNULL
    with subprocess.Popen(command, env=environment, stdout=devnull, stderr=devnull) as process:
        try:
            yield process
        finally:
            process.terminate()


CASES: Mapping[str, StartCase] = {
    "recording": partial(first_pose_s, camera="tum:RECORDING"),
    "Kinect": first_pose_of_kinect_s,
    "virtual Kinect": partial(first_pose_s, camera="synthetic"),
    "demo": first_picture_of_demo_s,
}

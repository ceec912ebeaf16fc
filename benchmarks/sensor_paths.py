"""The same frames by every input of the service: a folder, OpenNI2, fakenect and libfreenect.

    python -m benchmarks sensor_paths FOLDER [--frames N]

FOLDER is a TUM folder of 640x480 frames. It is replayed directly; as an .oni recording by the real
libOpenNI2; as a dump by the real fakenect; and by the Kinect simulator with the real libfreenect,
in the Kinect's own encoding: Bayer color and 11-bit depth. Each time `kinect-vo run` estimates the
poses. Distances are in mm.
"""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.tracking import read_all_frames
from drivers.calibration import find_calibration, format_calibration
from drivers.camera import PlaybackMode
from drivers.core.geometry import Trajectory, read_trajectory
from drivers.recording_camera import RecordingCamera
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, LoopMode
from tests.simulators.oni_writer import frames_to_oni_images, write_oni
from vo_service.tools.evaluation import evaluate

RATE_HZ = 30.0
# The source has ended after this time without a pose.
SILENCE_TIMEOUT_S = 4.0
MAX_RUN_S = 600.0
# Largest number of frames before the first pair of a live camera.
MAX_MISSED_FRAMES = 8


@dataclass(frozen=True)
class InputPath:
    """An input of the service."""

    name: str
    source: str
    pace: PlaybackMode
    environment: Mapping[str, str]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=None, help="use only the first N frames")


def main(args: argparse.Namespace) -> None:
    """Run each input and print the table."""
    with tempfile.TemporaryDirectory() as scratch:
        _compare(args.folder, args.frames, Path(scratch))


def _compare(folder: Path, max_frames: int | None, scratch: Path) -> None:
    """Print a line for each input."""
    camera_file = scratch / "camera.toml"
    camera_file.write_text(format_calibration(find_calibration(folder, None)))
    with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        truth = camera.ground_truth
        frames = list(islice(read_all_frames(camera), max_frames))
    assert truth is not None, f"{folder} has no ground truth"
    stamps_s = np.array([frame.stamp_s for frame in frames])
    dump, oni = scratch / "dump", scratch / "frames.oni"
    write_fakenect_dump(dump, folder_frames(folder, None, max_frames))
    write_oni(oni, frames_to_oni_images(frames))
    usb_frames = write_fitted_usb_frames(scratch, folder_frames(folder, None, max_frames))
    with KinectSimulator(scratch, usb_frames, registration=IDENTITY) as kinect:
        kinect.loop = LoopMode.ONCE
        input_paths = [
            InputPath("folder", f"tum:{folder}", PlaybackMode.LOCKSTEP, {}),
            InputPath(".oni, libOpenNI2", f"openni2:{oni}", PlaybackMode.LOCKSTEP, {}),
            InputPath("dump, fakenect", f"fakenect:{dump}", PlaybackMode.LOCKSTEP, {}),
            InputPath("Kinect, libfreenect", "freenect", PlaybackMode.REALTIME, kinect.environment),
        ]
        print(f"{'input':22s} poses  ATE RMSE  farthest from the folder's")
        reference = Trajectory(np.empty(0), np.empty((0, 4, 4)))
        for path in input_paths:
            trajectory = _run(path, camera_file, scratch, len(frames))
            trajectory = _match_to_frames(trajectory, stamps_s, truth)
            reference = trajectory if path.name == "folder" else reference
            ate_mm = 1e3 * evaluate(trajectory, truth).ate_rmse_m
            max_mm = 1e3 * max_distance_m(trajectory, reference)
            print(f"{path.name:22s} {len(trajectory):5d} {ate_mm:9.2f} {max_mm:9.3f}", flush=True)


def _run(input_path: InputPath, camera_file: Path, scratch: Path, count: int) -> Trajectory:
    """Return the poses that ``kinect-vo run`` writes, up to `count` or until it stops."""
    trajectory = scratch / f"{input_path.source.partition(':')[0]}.txt"
    command = [
        str(Path(sys.executable).with_name("kinect-vo")), "run", "--no-publish",
        "--camera", input_path.source, "--camera-file", str(camera_file), "--pace", input_path.pace,
        "--trajectory", str(trajectory),
    ]  # fmt: skip
    environment = {**os.environ, **input_path.environment}
    with subprocess.Popen(command, env=environment) as process:
        _wait_for_lines(trajectory, count, process)
        process.send_signal(signal.SIGTERM)
    return read_trajectory(trajectory)


def _wait_for_lines(file: Path, count: int, process: "subprocess.Popen[bytes]") -> None:
    """Wait until a file has `count` lines, or does not grow any more."""
    begin_s = last_s = time.monotonic()
    size = 0
    while process.poll() is None and time.monotonic() - begin_s < MAX_RUN_S:
        time.sleep(0.2)
        text = file.read_bytes() if file.exists() else b""
        if text.count(b"\n") >= count:
            return
        if len(text) != size:
            size, last_s = len(text), time.monotonic()
        if size and time.monotonic() - last_s > SILENCE_TIMEOUT_S:
            return


def _match_to_frames(estimated: Trajectory, stamps_s: np.ndarray, truth: Trajectory) -> Trajectory:
    """Replace the stamps by those of the recorded frames.

    A live camera's stamps are on this host's clock. Its first frame is chosen so that the
    trajectory fits the truth best.
    """
    index = np.rint((estimated.stamps_s - estimated.stamps_s[0]) * RATE_HZ).astype(int)
    if abs(estimated.stamps_s[0] - stamps_s[0]) < 10.0:
        return estimated
    candidates = []
    for first in range(MAX_MISSED_FRAMES):
        inside = index + first < len(stamps_s)
        poses = estimated.T_world_camera[inside]
        candidates.append(Trajectory(stamps_s[index[inside] + first], poses))
    return min(candidates, key=lambda poses: evaluate(poses, truth).ate_rmse_m)


def max_distance_m(estimated: Trajectory, reference: Trajectory) -> float:
    """Largest distance between positions of the same frame."""
    position = {
        round(stamp_s, 3): T[:3, 3]
        for stamp_s, T in zip(reference.stamps_s, reference.T_world_camera, strict=True)
    }
    return max(
        float(np.linalg.norm(T[:3, 3] - position[round(stamp_s, 3)]))
        for stamp_s, T in zip(estimated.stamps_s, estimated.T_world_camera, strict=True)
    )

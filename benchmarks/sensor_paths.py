"""The same frames by every way into the service: as a folder, through OpenNI2, through libfreenect.

    python -m benchmarks.sensor_paths FOLDER [--frames N]

FOLDER is a TUM folder of 640x480 frames. It is replayed as it is; written as an .oni recording and
played by the real libOpenNI2; written as a dump and played by the real fakenect; and played as a
Kinect on the wire, for the real libfreenect, in the Kinect's own encoding: one color a pixel
(Bayer) and 11 bits of depth. Each time it is `kinect-vo run` that finds the poses. Distances in mm.
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

from benchmarks.camera_frames import read_all_frames
from drivers.calibration import find_calibration, format_calibration
from drivers.camera import PlaybackMode
from drivers.core.trajectory import Trajectory, read_trajectory
from drivers.tum.camera import TumCamera
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, LoopMode
from tests.simulators.oni_writer import frames_to_oni_images, write_oni
from vo_service.tools.evaluation import evaluate

RATE_HZ = 30.0
# No pose for this long: the source has ended.
SILENCE_TIMEOUT_S = 4.0
MAX_RUN_S = 600.0
# How many frames may pass before the first pair of a live camera.
MAX_MISSED_FRAMES = 8


@dataclass(frozen=True)
class InputPath:
    """One way into the service."""

    name: str
    source: str
    pace: PlaybackMode
    environment: Mapping[str, str]


def main() -> int:
    """Run each way and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensor_paths",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=None, help="only the first N")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        compare(args.folder, args.frames, Path(scratch))
    return 0


def compare(folder: Path, max_frames: int | None, scratch: Path) -> None:
    """Print one line for each way."""
    camera_file = scratch / "camera.toml"
    camera_file.write_text(format_calibration(find_calibration(folder, None)))
    with TumCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
        truth = camera.ground_truth
        frames = list(islice(read_all_frames(camera), max_frames))
    assert truth is not None, f"{folder} has no ground truth"
    stamps_s = np.array([frame.stamp_s for frame in frames])
    dump, oni = scratch / "dump", scratch / "frames.oni"
    write_fakenect_dump(dump, folder_frames(folder, None, max_frames))
    write_oni(oni, frames_to_oni_images(frames))
    film = write_fitted_usb_frames(scratch, folder_frames(folder, None, max_frames))
    with KinectSimulator(scratch, film, registration=IDENTITY) as kinect:
        kinect.loop = LoopMode.ONCE
        ways = [
            InputPath("folder", f"tum:{folder}", PlaybackMode.LOCKSTEP, {}),
            InputPath(".oni, libOpenNI2", f"openni2:{oni}", PlaybackMode.LOCKSTEP, {}),
            InputPath("dump, fakenect", f"fakenect:{dump}", PlaybackMode.LOCKSTEP, {}),
            InputPath("Kinect, libfreenect", "freenect", PlaybackMode.REALTIME, kinect.environment),
        ]
        print(f"{'way':22s} poses  ATE RMSE  farthest from the folder's")
        reference = Trajectory(np.empty(0), np.empty((0, 4, 4)))
        for way in ways:
            found = run(way, camera_file, scratch, len(frames))
            found = match_to_frames(found, stamps_s, truth)
            reference = found if way.name == "folder" else reference
            ate_mm = 1e3 * evaluate(found, truth).ate_rmse_m
            apart_mm = 1e3 * max_distance_m(found, reference)
            print(f"{way.name:22s} {len(found):5d} {ate_mm:9.2f} {apart_mm:9.3f}", flush=True)


def run(input_path: InputPath, camera_file: Path, scratch: Path, count: int) -> Trajectory:
    """The poses that ``kinect-vo run`` writes, until `count` are there or none comes any more."""
    trajectory = scratch / f"{input_path.source.partition(':')[0]}.txt"
    command = [
        str(Path(sys.executable).with_name("kinect-vo")), "run", "--no-publish",
        "--camera", input_path.source, "--camera-file", str(camera_file), "--pace", input_path.pace,
        "--trajectory", str(trajectory),
    ]  # fmt: skip
    environment = {**os.environ, **input_path.environment}
    with subprocess.Popen(command, env=environment) as process:
        wait_for_lines(trajectory, count, process)
        process.send_signal(signal.SIGTERM)
    return read_trajectory(trajectory)


def wait_for_lines(file: Path, count: int, process: "subprocess.Popen[bytes]") -> None:
    """Until the file has so many lines, or has had its last one."""
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


def match_to_frames(found: Trajectory, stamps_s: np.ndarray, truth: Trajectory) -> Trajectory:
    """`found` with the stamps of the frames that were played.

    A live camera's stamps are of this host's clock; the first frame that it delivered is the one
    that makes the whole fit the truth best.
    """
    index = np.rint((found.stamps_s - found.stamps_s[0]) * RATE_HZ).astype(int)
    if abs(found.stamps_s[0] - stamps_s[0]) < 10.0:
        return found
    candidates = []
    for first in range(MAX_MISSED_FRAMES):
        inside = index + first < len(stamps_s)
        poses = found.T_world_camera[inside]
        candidates.append(Trajectory(stamps_s[index[inside] + first], poses))
    return min(candidates, key=lambda poses: evaluate(poses, truth).ate_rmse_m)


def max_distance_m(found: Trajectory, reference: Trajectory) -> float:
    """Largest distance between positions of the same frame."""
    position = {
        round(stamp_s, 3): T[:3, 3]
        for stamp_s, T in zip(reference.stamps_s, reference.T_world_camera, strict=True)
    }
    return max(
        float(np.linalg.norm(T[:3, 3] - position[round(stamp_s, 3)]))
        for stamp_s, T in zip(found.stamps_s, found.T_world_camera, strict=True)
    )


if __name__ == "__main__":
    sys.exit(main())

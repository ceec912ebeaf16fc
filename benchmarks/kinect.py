"""The Kinect's driver: its processor time, its images through each camera, and its stamps.

`cost` and `paths` use a simulated Kinect with the real libfreenect, `stamp` a real one.
"""

import argparse
import ctypes
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.harness import Table, Variants, median, option, run_in_turn
from benchmarks.led_timing import measure_stamp
from benchmarks.processes import Load, LoadMeter
from benchmarks.tracking import open_frames_with_truth
from drivers.calibration import find_calibration, format_calibration
from drivers.camera import Clock, PlaybackMode, SensorConfig
from drivers.core.geometry import Trajectory, read_trajectory
from drivers.freenect.bindings import COLOR_BAYER, DEPTH_11_BIT_PACKED, FRAME_CALLBACK
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.sources import KinectSource
from drivers.kinect_usb.motor_unit import MotorUnit
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.freenect_probe import FreenectProbe, StreamCapture
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, LoopMode, write_usb_frames
from tests.simulators.oni_writer import frames_to_oni_images, write_oni
from tests.vo_service.service_process import KINECT_VO
from vo_service.tools.evaluation.evaluation import evaluate
from vo_service.tools.evaluation.metrics import associate, position_errors_m

WARM_UP_S = 2.0
COST_TABLE = Table(12, "% of a core:12.2f", "ratio:8.2f")
PATHS_TABLE = Table(22, "poses:6d", "ATE:9.2mm", "farthest:10.3mm")
RATE_HZ = 30.0
# The source has ended after this time without a pose.
SILENCE_TIMEOUT_S = 4.0
MAX_RUN_S = 600.0
# Largest number of frames before the first pair of a live camera.
MAX_MISSED_FRAMES = 8


def make_kinect_without_motor() -> FreenectCamera:
    """Make the camera of the first Kinect, without motor and accelerometer."""
    settings = SensorConfig()
    return FreenectCamera(KinectSource("", settings), None, MotorUnit(), settings)


class CopyingProbe(FreenectProbe):
    """A program on libfreenect whose callbacks copy the images as they are sent."""

    def _make_callback(self, capture: StreamCapture, mode: Any, kind: type[np.generic]) -> Any:
        buffer = ctypes.create_string_buffer(mode.bytes)

        def copy(_device: int, pixels: int, _stamp: int) -> None:
            ctypes.memmove(buffer, pixels, mode.bytes)

        self._callbacks.append(FRAME_CALLBACK(copy))
        return self._callbacks[-1]


def measure_bare_loop(seconds: float) -> float:
    """Measure a loop around libfreenect."""
    with CopyingProbe() as probe:
        probe.start(DEPTH_11_BIT_PACKED.number, COLOR_BAYER.number)
        return _measure_load(lambda: probe.process(0.02), seconds).percent()


def measure_subprocess(seconds: float) -> float:
    """Measure the process of a subprocess camera that this process reads."""
    camera = SubprocessCamera(
        "freenect", Clock.MONOTONIC, make_kinect_without_motor, PlaybackMode.REALTIME
    )
    with camera:
        load = _measure_load(lambda: camera.read(20.0), seconds)
        return load.percent_without(os.getpid())


DRIVERS: Mapping[str, Callable[[float], float]] = {
    "bare": measure_bare_loop,
    "isolated": measure_subprocess,
}


def _measure_load(step: Callable[[], object], seconds: float) -> Load:
    """Measure this process and its children during `seconds` of steps, after the warm-up."""
    _repeat(step, WARM_UP_S)
    meter = LoadMeter(os.getpid())
    _repeat(step, seconds)
    return meter.read()


def _repeat(step: Callable[[], object], seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        step()


@option("--seconds", type=float, default=10.0, help="duration of each variant")
@option("--rounds", type=int, default=3, help="runs of each variant; the median counts")
def measure_cost(args: argparse.Namespace) -> None:
    """CPU time of the Kinect driver, compared with a bare libfreenect loop that copies each image.

    Both run on the same simulated Kinect, one after another in separate processes, after two
    seconds of warm-up. The simulator runs in the same process and costs the same each time.
    `isolated` counts only the driver's process, with its frame ring. The loop converts no image.
    """
    with tempfile.TemporaryDirectory() as folder:
        frames = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), frames, registration=IDENTITY) as kinect:
            measure = partial(_measure_percent, args.seconds, kinect)
            percent = run_in_turn({name: partial(measure, name) for name in DRIVERS}, args.rounds)
    bare = median(percent["bare"])
    print(COST_TABLE.head)
    for variant, measured in percent.items():
        print(COST_TABLE.row(variant, median(measured), median(measured) / bare))


def _measure_percent(seconds: float, kinect: KinectSimulator, variant: str) -> float:
    """Measure the share of one core that the driver uses."""
    command = [sys.executable, "-m", "benchmarks.kinect", variant, str(seconds)]
    environment = os.environ | kinect.environment
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return float(run.stdout)


@option("folder", type=Path)
@option("--frames", type=int, default=None, help="use only the first N frames")
def compare_paths(args: argparse.Namespace) -> None:
    """Poses of the same frames through each camera of the service.

    FOLDER is a TUM folder of 640x480 frames. It is replayed directly; as an .oni recording by the
    real libOpenNI2; as a dump by the real fakenect; and by the Kinect simulator with the real
    libfreenect, in the Kinect's own encoding: Bayer color and 11-bit depth. Each time `kinect-vo
    run` estimates the poses. Distances are in millimeters; the last is that from the folder's own
    trajectory.
    """
    with tempfile.TemporaryDirectory() as scratch:
        _compare(args.folder, args.frames, Path(scratch))


def _compare(folder: Path, max_frames: int | None, scratch: Path) -> None:
    """Print a line for each input."""
    camera_file = scratch / "camera.toml"
    camera_file.write_text(format_calibration(find_calibration(folder, None)))
    with open_frames_with_truth(folder) as (all_frames, truth):
        frames = list(islice(all_frames, max_frames))
    stamps_s = np.array([frame.stamp_s for frame in frames])
    dump, oni = scratch / "dump", scratch / "frames.oni"
    write_fakenect_dump(dump, folder_frames(folder, None, max_frames))
    write_oni(oni, frames_to_oni_images(frames))
    usb_frames = write_fitted_usb_frames(scratch, folder_frames(folder, None, max_frames))
    with KinectSimulator(scratch, usb_frames, registration=IDENTITY) as kinect:
        kinect.loop = LoopMode.ONCE
        sources = {
            "folder": f"tum:{folder}",
            ".oni, libOpenNI2": f"openni2:{oni}",
            "dump, fakenect": f"fakenect:{dump}",
            "Kinect, libfreenect": "freenect",
        }
        print(PATHS_TABLE.head)
        reference = Trajectory(np.empty(0), np.empty((0, 4, 4)))
        for name, source in sources.items():
            pace, variables = PlaybackMode.LOCKSTEP, dict[str, str]()
            if source == "freenect":
                pace, variables = PlaybackMode.REALTIME, dict(kinect.environment)
            options = ("--camera", source, "--camera-file", str(camera_file), "--pace", pace)
            trajectory = _run(options, variables, scratch / f"{name}.txt", len(frames))
            trajectory = _match_to_frames(trajectory, stamps_s, truth)
            reference = trajectory if name == "folder" else reference
            ate_m = evaluate(trajectory, truth).ate_rmse_m
            max_m = position_errors_m(associate(trajectory, reference), np.eye(4)).max()
            print(PATHS_TABLE.row(name, len(trajectory), ate_m, max_m), flush=True)


def _run(
    options: Sequence[str], variables: Mapping[str, str], trajectory: Path, count: int
) -> Trajectory:
    """Return the poses that ``kinect-vo run`` writes, up to `count` or until it stops."""
    command = [KINECT_VO, "run", "--no-publish", *options, "--trajectory", str(trajectory)]
    with subprocess.Popen(command, env={**os.environ, **variables}) as process:
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


VARIANTS: Variants = {
    "cost": measure_cost,
    "paths": compare_paths,
    "stamp": measure_stamp,
}

if __name__ == "__main__":  # one of DRIVERS
    # The driver's process imports its camera by the name of this module.
    from benchmarks import kinect

    cv2.setNumThreads(1)  # as in a driver's own process
    print(kinect.DRIVERS[sys.argv[1]](float(sys.argv[2])))

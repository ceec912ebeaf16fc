"""CPU time of the Kinect driver, compared with a bare libfreenect loop that copies each image.

    python -m benchmarks freenect_cost [--seconds 10] [--rounds 3]

All three variants run on the same simulated Kinect, one after another in separate processes, after
two seconds of warm-up. The simulator runs in the same process and costs the same each time.
`isolated` counts only the driver's process, with its frame ring. The ratio should be at most 1.5.
"""

import argparse
import ctypes
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import cv2

from drivers.camera import Clock, PlaybackMode, SensorConfig
from drivers.freenect import (
    CAMERA_ONLY,
    FRAME_CALLBACK,
    RESOLUTION_640X480,
    VIDEO_RGB,
    DepthFormat,
    TimeValue,
    load_library,
)
from drivers.freenect.camera import FreenectCamera
from drivers.freenect.rectify import KinectRectifier
from drivers.freenect.sources import KinectSource, list_kinects
from drivers.kinect_usb.motor_unit import MotorUnit
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, write_usb_frames


def make_kinect_without_motor() -> FreenectCamera:
    """Make the camera of the first Kinect, without motor and accelerometer."""
    settings = SensorConfig()
    images = KinectRectifier(None, is_mirrored=False)
    return FreenectCamera(KinectSource("", settings), images, MotorUnit(), settings)


WARM_UP_S = 2.0
COLOR_BYTES, DEPTH_BYTES = 640 * 480 * 3, 640 * 480 * 2


def measure_bare_loop(seconds: float) -> float:
    """Measure a loop around libfreenect with callbacks that copy."""
    library = load_library()
    context, device = ctypes.c_void_p(), ctypes.c_void_p()
    library.freenect_init(ctypes.byref(context), None)
    library.freenect_select_subdevices(context, CAMERA_ONLY)
    (serial,) = list_kinects()
    library.freenect_open_device_by_camera_serial(context, ctypes.byref(device), serial.encode())
    registered = library.freenect_find_depth_mode(RESOLUTION_640X480, DepthFormat.REGISTERED_MM)
    library.freenect_set_depth_mode(device, registered)
    rgb = library.freenect_find_video_mode(RESOLUTION_640X480, VIDEO_RGB)
    library.freenect_set_video_mode(device, rgb)
    callbacks = [_make_copying_callback(COLOR_BYTES), _make_copying_callback(DEPTH_BYTES)]
    library.freenect_set_video_callback(device, callbacks[0])
    library.freenect_set_depth_callback(device, callbacks[1])
    library.freenect_start_depth(device)
    library.freenect_start_video(device)
    step = partial(library.freenect_process_events_timeout, context, TimeValue(0, 20_000))
    percent = _cpu_percent(step, time.process_time, seconds)
    library.freenect_stop_depth(device)
    library.freenect_stop_video(device)
    library.freenect_close_device(device)
    library.freenect_shutdown(context)
    return percent


def measure_in_process(seconds: float) -> float:
    """Measure the camera read in this process."""
    with make_kinect_without_motor() as camera:
        return _cpu_percent(lambda: camera.read(5.0), time.process_time, seconds)


def measure_subprocess(seconds: float) -> float:
    """Measure the process of a subprocess camera that this process reads."""
    camera = SubprocessCamera(
        "freenect", Clock.MONOTONIC, make_kinect_without_motor, PlaybackMode.REALTIME
    )
    with camera:
        return _cpu_percent(lambda: camera.read(20.0), _children_cpu_s, seconds)


VARIANTS: dict[str, Callable[[float], float]] = {
    "bare": measure_bare_loop,
    "in process": measure_in_process,
    "isolated": measure_subprocess,
}


def _make_copying_callback(size: int) -> Any:
    buffer = ctypes.create_string_buffer(size)

    def copy(_device: int, pixels: int, _stamp: int) -> None:
        ctypes.memmove(buffer, pixels, size)

    return FRAME_CALLBACK(copy)


def _cpu_percent(step: Callable[[], object], cpu_s: Callable[[], float], seconds: float) -> float:
    """Measure the CPU share of `seconds` of steps after the warm-up, in percent of a core."""
    _repeat(step, WARM_UP_S)
    begin_s, begin_cpu_s = time.monotonic(), cpu_s()
    _repeat(step, seconds)
    return 100 * (cpu_s() - begin_cpu_s) / (time.monotonic() - begin_s)


def _repeat(step: Callable[[], object], seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        step()


def _children_cpu_s() -> float:
    """CPU time used so far by the running child processes."""
    tasks = Path("/proc/self/task").glob("*/children")
    children = [pid for task in tasks for pid in task.read_text().split()]
    return sum(time.clock_gettime(~int(pid) << 3 | 2) for pid in children)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--seconds", type=float, default=10.0, help="duration of each variant")
    parser.add_argument(
        "--rounds", type=int, default=3, help="runs of each variant; the median counts"
    )


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        frames = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), frames, registration=IDENTITY) as kinect:
            percent: dict[str, list[float]] = {variant: [] for variant in VARIANTS}
            for _ in range(args.rounds):
                for variant, measured in percent.items():
                    measured.append(_measure_percent(variant, args.seconds, kinect))
    bare = median(percent["bare"])
    print("variant      % of a core   ratio")
    for variant, measured in percent.items():
        print(f"{variant:12} {median(measured):11.2f} {median(measured) / bare:7.2f}")


def _measure_percent(variant: str, seconds: float, kinect: KinectSimulator) -> float:
    """Measure the share of one core that the driver uses."""
    command = [sys.executable, "-m", "benchmarks.freenect_cost", variant, str(seconds)]
    environment = os.environ | kinect.environment
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return float(run.stdout)


if __name__ == "__main__":  # one variant
    # The driver's process imports its camera by the name of this module.
    from benchmarks import freenect_cost

    cv2.setNumThreads(1)  # as in a driver's own process
    print(freenect_cost.VARIANTS[sys.argv[1]](float(sys.argv[2])))

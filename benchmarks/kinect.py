"""The Kinect's driver: its processor time, its images through each camera, and its stamps.

    python -m benchmarks kinect cost [--seconds 10] [--rounds 3]
    python -m benchmarks kinect paths FOLDER [--frames N]
    python -m benchmarks kinect stamp [--serial SERIAL] [--seconds 60]

`cost` and `paths` use a simulated Kinect with the real libfreenect, `stamp` a real one.
"""

import argparse
import ctypes
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import Table, Variants, option
from benchmarks.service_load import measure_processor_use
from benchmarks.tracking import open_frames_with_truth
from drivers.calibration import find_calibration, format_calibration
from drivers.camera import Clock, FrameTimeout, Led, PlaybackMode, RgbdFrame, SensorConfig
from drivers.core import UserFacingError
from drivers.core.geometry import Array, Trajectory, read_trajectory
from drivers.freenect.bindings import (
    CAMERA_ONLY,
    COLOR_BAYER,
    DEPTH_11_BIT_PACKED,
    FRAME_CALLBACK,
    RESOLUTION_640X480,
    TimeValue,
    load_library,
)
from drivers.freenect.camera import FreenectCamera, make_kinect_camera
from drivers.freenect.sources import KinectSource
from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
from drivers.kinect_usb.motor_unit import MotorUnit
from drivers.kinect_usb.usb_devices import find_kinect
from drivers.subprocess_camera.camera import SubprocessCamera
from tests.resource_leaks import child_pids_of
from tests.simulators.fakenect_dump import write_fakenect_dump
from tests.simulators.fixtures import FRAME_COUNT, pattern_frame
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import (
    IDENTITY,
    KinectSimulator,
    LoopMode,
    write_usb_frames,
)
from tests.simulators.oni_writer import frames_to_oni_images, write_oni
from tests.vo_service.service_process import KINECT_VO
from vo_service.tools.evaluation.evaluation import evaluate

WARM_UP_S = 2.0
COLOR_BYTES, DEPTH_BYTES = 640 * 480, 640 * 480 * 11 // 8
COST_TABLE = Table(12, "% of a core:12.2f", "ratio:8.2f")
PATHS_TABLE = Table(22, "poses:6d", "ATE:9.2f", "farthest:10.3f")
RATE_HZ = 30.0
# The source has ended after this time without a pose.
SILENCE_TIMEOUT_S = 4.0
MAX_RUN_S = 600.0
# Largest number of frames before the first pair of a live camera.
MAX_MISSED_FRAMES = 8
# Search range: how far the stamp may be before or after the middle of the exposure.
DELAY_GRID_S = np.arange(-0.100, 0.1001, 0.0005)
EXPOSURE_GRID_S = np.arange(0.002, 0.0341, 0.002)
# Fraction of the image's pixels that follow the LED best.
LIT_PIXEL_FRACTION = 0.001
# Time between two switches: far longer than an exposure, and not synchronous with the frames.
MIN_SWITCH_S, MAX_SWITCH_S = 0.25, 0.6
# The LED's mirror image is larger than a few pixels, so smaller images show it too.
PIXEL_STRIDE = 4
MIN_EXPLAINED = 0.6
FIRST_FRAME_TIMEOUT_S = 15.0


def make_kinect_without_motor() -> FreenectCamera:
    """Make the camera of the first Kinect, without motor and accelerometer."""
    settings = SensorConfig()
    return FreenectCamera(KinectSource("", settings), None, MotorUnit(), settings)


def measure_bare_loop(seconds: float) -> float:
    """Measure a loop around libfreenect with callbacks that copy the images as they are sent."""
    library = load_library()
    context, device = ctypes.c_void_p(), ctypes.c_void_p()
    library.freenect_init(ctypes.byref(context), None)
    library.freenect_select_subdevices(context, CAMERA_ONLY)
    serial = find_kinect("").read_serial()
    library.freenect_open_device_by_camera_serial(context, ctypes.byref(device), serial.encode())
    depth = library.freenect_find_depth_mode(RESOLUTION_640X480, DEPTH_11_BIT_PACKED.number)
    library.freenect_set_depth_mode(device, depth)
    color = library.freenect_find_video_mode(RESOLUTION_640X480, COLOR_BAYER.number)
    library.freenect_set_video_mode(device, color)
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


DRIVERS: Mapping[str, Callable[[float], float]] = {
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
    children = child_pids_of(os.getpid())
    return sum(measure_processor_use(*children).by_process.values())


COST_OPTIONS = (
    option("--seconds", type=float, default=10.0, help="duration of each variant"),
    option("--rounds", type=int, default=3, help="runs of each variant; the median counts"),
)


def measure_cost(args: argparse.Namespace) -> None:
    """CPU time of the Kinect driver, compared with a bare libfreenect loop that copies each image.

    All three variants run on the same simulated Kinect, one after another in separate processes,
    after two seconds of warm-up. The simulator runs in the same process and costs the same each
    time. `isolated` counts only the driver's process, with its frame ring. The loop converts no
    image; `kinect_load steps` has the time of the conversion.
    """
    with tempfile.TemporaryDirectory() as folder:
        frames = write_usb_frames(Path(folder), (pattern_frame(seq) for seq in range(FRAME_COUNT)))
        with KinectSimulator(Path(folder), frames, registration=IDENTITY) as kinect:
            percent: dict[str, list[float]] = {variant: [] for variant in DRIVERS}
            for _ in range(args.rounds):
                for variant, measured in percent.items():
                    measured.append(_measure_percent(variant, args.seconds, kinect))
    bare = median(percent["bare"])
    print(COST_TABLE.head)
    for variant, measured in percent.items():
        print(COST_TABLE.row(variant, median(measured), median(measured) / bare))


def _measure_percent(variant: str, seconds: float, kinect: KinectSimulator) -> float:
    """Measure the share of one core that the driver uses."""
    command = [sys.executable, "-m", "benchmarks.kinect", variant, str(seconds)]
    environment = os.environ | kinect.environment
    run = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True, text=True)
    return float(run.stdout)


@dataclass(frozen=True)
class InputPath:
    """An input of the service."""

    name: str
    source: str
    pace: PlaybackMode
    environment: Mapping[str, str]


PATHS_OPTIONS = (
    option("folder", type=Path),
    option("--frames", type=int, default=None, help="use only the first N frames"),
)


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
        input_paths = [
            InputPath("folder", f"tum:{folder}", PlaybackMode.LOCKSTEP, {}),
            InputPath(".oni, libOpenNI2", f"openni2:{oni}", PlaybackMode.LOCKSTEP, {}),
            InputPath("dump, fakenect", f"fakenect:{dump}", PlaybackMode.LOCKSTEP, {}),
            InputPath("Kinect, libfreenect", "freenect", PlaybackMode.REALTIME, kinect.environment),
        ]
        print(PATHS_TABLE.head)
        reference = Trajectory(np.empty(0), np.empty((0, 4, 4)))
        for path in input_paths:
            trajectory = _run(path, camera_file, scratch, len(frames))
            trajectory = _match_to_frames(trajectory, stamps_s, truth)
            reference = trajectory if path.name == "folder" else reference
            ate_mm = 1e3 * evaluate(trajectory, truth).ate_rmse_m
            max_mm = 1e3 * max_distance_m(trajectory, reference)
            print(PATHS_TABLE.row(path.name, len(trajectory), ate_mm, max_mm), flush=True)


def _run(input_path: InputPath, camera_file: Path, scratch: Path, count: int) -> Trajectory:
    """Return the poses that ``kinect-vo run`` writes, up to `count` or until it stops."""
    trajectory = scratch / f"{input_path.source.partition(':')[0]}.txt"
    command = [
        KINECT_VO, "run", "--no-publish",
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


@dataclass(frozen=True)
class LedTiming:
    """The middle of the exposure relative to the stamp.

    Attributes:
        delay_s: Middle of the exposure minus stamp, including the LED's own delay.
        exposure_s: Duration of the exposure.
        explained_variance: Fraction of the brightness's variance that the fit explains.
    """

    delay_s: float
    exposure_s: float
    explained_variance: float


def find_lit_pixels(pictures: NDArray[np.uint8], is_on: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the pixels (height, width) of pictures (n, height, width) that follow the LED best."""
    shine = pictures[is_on].mean(axis=0) - pictures[~is_on].mean(axis=0)
    follows = shine / (pictures.std(axis=0) + 1.0)
    count = max(1, round(LIT_PIXEL_FRACTION * follows.size))
    return np.asarray(follows >= np.partition(follows.ravel(), -count)[-count])


def fit_timing(stamps_s: Array, brightness: Array, switched_s: Array) -> LedTiming:
    """Fit delay and exposure.

    Args:
        stamps_s: Stamps (n,).
        brightness: Brightness (n,) of the lit pixels.
        switched_s: Times (m,) of the switching commands on the same clock, the first to on.
    """
    best = LedTiming(0.0, 0.0, -np.inf)
    middles_s = (DELAY_GRID_S[:, None] + stamps_s).ravel()
    for exposure_s in EXPOSURE_GRID_S:
        lit = exposed_fraction(middles_s, exposure_s, switched_s)
        explained = _explained_variance(lit.reshape(len(DELAY_GRID_S), -1), brightness)
        k = int(explained.argmax())
        if explained[k] > best.explained_variance:
            best = LedTiming(float(DELAY_GRID_S[k]), float(exposure_s), float(explained[k]))
    return best


def exposed_fraction(middles_s: Array, exposure_s: float, switched_s: Array) -> Array:
    """Fraction (n,) of each exposure during which the LED is on.

    Args:
        middles_s: (n,) middles of the exposures, s.
        exposure_s: Length of an exposure, s.
        switched_s: Times at which the LED was switched, first on, s.
    """
    begin, end = middles_s - exposure_s / 2, middles_s + exposure_s / 2
    return (_cumulative_on_s(end, switched_s) - _cumulative_on_s(begin, switched_s)) / exposure_s


def _cumulative_on_s(until_s: Array, switched_s: Array) -> Array:
    """Seconds that the LED was on before each time."""
    is_on = np.arange(len(switched_s)) % 2 == 0
    spans_s = np.diff(switched_s, append=np.inf) * 1.0
    since_s = np.clip(until_s[:, None] - switched_s[None, :], 0.0, spans_s[None, :])
    return np.asarray((since_s * is_on).sum(axis=1))


def _explained_variance(lit: Array, brightness: Array) -> Array:
    """Squared correlation (d,) of each row of `lit` (d, n) with the brightness (n,)."""
    lit = lit - lit.mean(axis=1, keepdims=True)
    brightness = brightness - brightness.mean()
    squares = (lit**2).sum(axis=1) * (brightness**2).sum()
    return np.asarray((lit @ brightness) ** 2 / np.where(squares > 0.0, squares, np.inf))


class BlinkingLight:
    """Switches an LED at irregular times in a thread, and records the times."""

    def __init__(self, switch: Callable[[bool], None]) -> None:
        self._switch = switch
        self._stop = threading.Event()
        self.switched_s: list[float] = []
        self._thread = threading.Thread(target=self._run, name="light", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        is_on = False
        while not self._stop.wait(random.uniform(MIN_SWITCH_S, MAX_SWITCH_S)):
            is_on = not is_on
            begin_s = time.monotonic()
            self._switch(is_on)
            self.switched_s.append((begin_s + time.monotonic()) / 2)

    def stop(self) -> None:
        """Stop switching."""
        self._stop.set()
        self._thread.join()


STAMP_OPTIONS = (
    option("--serial", default="", help="serial number (default: the first Kinect)"),
    option("--seconds", type=float, default=60.0, help="duration"),
)


def measure_stamp(args: argparse.Namespace) -> int:
    """Offset of a Kinect's color stamp from the exposure, measured by its own LED in a mirror.

    Put the Kinect in front of a mirror in a dim room, so that it sees its own LED. The LED is
    switched on and off at irregular times, which are known to a millisecond. The brightness of the
    pixels that follow it gives the middle of the exposure relative to the stamps. Exit code 1 if
    the LED is not visible. Remove stamp_offset_s from the configuration first: the printed figure
    is its value.
    """
    return report_stamp(record_led(args.serial, args.seconds))


@dataclass
class LedObservations:
    """Small gray images with their stamps, and the times of the switches."""

    stamps_s: list[float]
    pictures: list[NDArray[np.uint8]]
    switched_s: list[float]

    def add(self, frame: RgbdFrame) -> None:
        """Add the small image and the stamp of a frame."""
        self.stamps_s.append(frame.stamp_s)
        self.pictures.append(frame.gray[::PIXEL_STRIDE, ::PIXEL_STRIDE].copy())


def record_led(serial: str, seconds: float) -> LedObservations:
    """Record frames for `seconds` while the LED is switched; the first switch is to on."""
    recipe = partial(make_kinect_camera, serial, SensorConfig(led=Led.OFF), None)
    observations, base = LedObservations([], [], []), KinectMotorUnit()
    with SubprocessCamera("freenect", Clock.MONOTONIC, recipe, PlaybackMode.LOCKSTEP) as camera:
        try:
            observations.add(camera.read(FIRST_FRAME_TIMEOUT_S))
            base.open(serial)
            light = BlinkingLight(lambda is_on: base.set_led(Led.GREEN if is_on else Led.OFF))
            try:
                while observations.stamps_s[-1] - observations.stamps_s[0] < seconds:
                    observations.add(camera.read(FIRST_FRAME_TIMEOUT_S))
            finally:
                light.stop()
                base.close()
        except FrameTimeout:
            raise UserFacingError(f"no frame: {camera.status}") from None
    observations.switched_s.extend(light.switched_s)
    return observations


def report_stamp(observations: LedObservations) -> int:
    """Print the delay; return 1 if the LED is not visible."""
    stamps_s, switched_s = np.array(observations.stamps_s), np.array(observations.switched_s)
    pictures = np.array(observations.pictures)
    is_on = np.searchsorted(switched_s, stamps_s) % 2 == 1
    brightness = pictures[:, find_lit_pixels(pictures, is_on)].mean(axis=1)
    timing = fit_timing(stamps_s, brightness, switched_s)
    print(f"frames             {len(stamps_s)}, switches {len(switched_s)}")
    print(f"LED explains       {100 * timing.explained_variance:.0f} % of the brightness")
    if timing.explained_variance < MIN_EXPLAINED:
        print("the LED is not visible: put a mirror close in front of it and darken the room")
        return 1
    print(f"exposure           {1e3 * timing.exposure_s:.0f} ms")
    print(f"stamp_offset_s     {timing.delay_s:.4f}  (middle of the exposure minus stamp)")
    return 0


VARIANTS: Variants = {
    "cost": (COST_OPTIONS, measure_cost),
    "paths": (PATHS_OPTIONS, compare_paths),
    "stamp": (STAMP_OPTIONS, measure_stamp),
}

if __name__ == "__main__":  # one of DRIVERS
    # The driver's process imports its camera by the name of this module.
    from benchmarks import kinect

    cv2.setNumThreads(1)  # as in a driver's own process
    print(kinect.DRIVERS[sys.argv[1]](float(sys.argv[2])))

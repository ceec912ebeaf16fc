"""The offset of a Kinect's color stamp from the exposure, by its own LED in a mirror."""

import argparse
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import option
from drivers.camera import Clock, FrameTimeout, Led, PlaybackMode, SensorConfig
from drivers.core import UserFacingError
from drivers.core.geometry import Array
from drivers.freenect.camera import make_kinect_camera
from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
from drivers.subprocess_camera.camera import SubprocessCamera

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
        stamps_s: (n,).
        brightness: (n,) of the lit pixels.
        switched_s: (m,) times of the switching commands on the same clock, the first to on.
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
    # The last state lasts until the end.
    marks_s = np.append(switched_s, max(middles_s.max(), switched_s[-1]) + exposure_s)
    spans_s = np.diff(marks_s) * (np.arange(len(switched_s)) % 2 == 0)
    on_s = np.concatenate([[0.0], np.cumsum(spans_s)])
    begins_s, ends_s = middles_s - exposure_s / 2, middles_s + exposure_s / 2
    lit_s = np.interp(ends_s, marks_s, on_s) - np.interp(begins_s, marks_s, on_s)
    return np.asarray(lit_s / exposure_s)


def _explained_variance(lit: Array, brightness: Array) -> Array:
    """Squared correlation (d,) of each row of `lit` (d, n) with the brightness (n,)."""
    lit = lit - lit.mean(axis=1, keepdims=True)
    brightness = brightness - brightness.mean()
    squares = (lit**2).sum(axis=1) * (brightness**2).sum()
    return np.asarray((lit @ brightness) ** 2 / np.where(squares > 0.0, squares, np.inf))


@contextmanager
def blinking(switch: Callable[[bool], None]) -> Iterator[list[float]]:
    """Switch an LED at irregular times in a thread; yield the list of these times, which grows."""
    is_over, switched_s = threading.Event(), list[float]()

    def run() -> None:
        is_on = False
        while not is_over.wait(random.uniform(MIN_SWITCH_S, MAX_SWITCH_S)):
            is_on = not is_on
            begin_s = time.monotonic()
            switch(is_on)
            switched_s.append((begin_s + time.monotonic()) / 2)

    thread = threading.Thread(target=run, name="light", daemon=True)
    thread.start()
    try:
        yield switched_s
    finally:
        is_over.set()
        thread.join()


@option("--serial", default="", help="serial number (default: the first Kinect)")
@option("--seconds", type=float, default=60.0, help="duration")
def measure_stamp(args: argparse.Namespace) -> int:
    """Offset of a Kinect's color stamp from the exposure, measured by its own LED in a mirror.

    Put the Kinect in front of a mirror in a dim room, so that it sees its own LED. The LED is
    switched on and off at irregular times, which are known to a millisecond. The brightness of the
    pixels that follow it gives the middle of the exposure relative to the stamps. Exit code 1 if
    the LED is not visible. Remove stamp_offset_s from the configuration first: the printed figure
    is its value.
    """
    stamps_s, pictures, switched_s = record_led(args.serial, args.seconds)
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


def record_led(serial: str, seconds: float) -> tuple[Array, NDArray[np.uint8], Array]:
    """Record frames for `seconds` while the LED is switched; the first switch is to on.

    Returns:
        Stamps (n,), small gray images (n, height, width), and times of the switches (m,).
    """
    recipe = partial(make_kinect_camera, serial, SensorConfig(led=Led.OFF), None)
    camera = SubprocessCamera("freenect", Clock.MONOTONIC, recipe, PlaybackMode.LOCKSTEP)
    stamps_s, pictures = [], []

    def record() -> None:
        frame = camera.read(FIRST_FRAME_TIMEOUT_S)
        stamps_s.append(frame.stamp_s)
        pictures.append(frame.gray[::PIXEL_STRIDE, ::PIXEL_STRIDE].copy())

    with camera, closing(KinectMotorUnit()) as base:
        try:
            record()
            base.open(serial)
            with blinking(lambda is_on: base.set_led(Led.GREEN if is_on else Led.OFF)) as times_s:
                while stamps_s[-1] - stamps_s[0] < seconds:
                    record()
        except FrameTimeout:
            raise UserFacingError(f"no frame: {camera.status}") from None
    return np.array(stamps_s), np.array(pictures), np.array(times_s)

"""Offset of a Kinect's color stamp from the exposure, measured by its own LED in a mirror.

    python -m benchmarks.stamp_instant [--serial SERIAL] [--seconds 60]

Put the Kinect in front of a mirror in a dim room, so that it sees its own LED. The LED is switched
on and off at irregular times, which are known to a millisecond. The brightness of the pixels that
follow it gives the middle of the exposure relative to the stamps. Exit code 1 if the LED is not
visible. Remove stamp_offset_s from the configuration first: the printed figure is its value.
"""

import argparse
import random
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks.led_timing import find_lit_pixels, fit_timing
from drivers.camera import Clock, FrameTimeout, Led, PlaybackMode, RgbdFrame, SensorConfig
from drivers.core.errors import UserFacingError
from drivers.freenect.factory import make_kinect_camera
from drivers.kinect_usb.kinect_motor_unit import KinectMotorUnit
from drivers.subprocess_camera.camera import SubprocessCamera

# Time between two switches: far longer than an exposure, and not synchronous with the frames.
MIN_SWITCH_S, MAX_SWITCH_S = 0.25, 0.6
# The LED's mirror image is larger than a few pixels, so smaller images show it too.
PIXEL_STRIDE = 4
MIN_EXPLAINED = 0.6
FIRST_FRAME_TIMEOUT_S = 15.0


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


def main() -> int:
    """Record the LED and print the result."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.stamp_instant",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--serial", default="", help="serial number (default: the first Kinect)")
    parser.add_argument("--seconds", type=float, default=60.0, help="duration")
    args = parser.parse_args()
    try:
        observations = record_led(args.serial, args.seconds)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    return report(observations)


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


def report(observations: LedObservations) -> int:
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


if __name__ == "__main__":
    sys.exit(main())

"""The interface to the Kinect's motor, LED and accelerometer, independent of any USB library."""

import math
from collections import deque
from dataclasses import dataclass
from statistics import fmean
from typing import Protocol

from drivers.camera import AccelerometerReading, Led, SensorConfig
from drivers.core import CameraError
from drivers.core.geometry import (
    STANDARD_GRAVITY_M_S2,
    Vector,
    gravity_from_accelerometer,
    is_gravity,
)

COUNTS_PER_G = 819.0
AVERAGING_WINDOW_S = 1.0


def gravity_from_counts(x: int, y: int, z: int) -> Vector | None:
    """Convert counts to gravity in camera axes, m/s^2; None for three zeros (no data)."""
    if not any((x, y, z)):
        return None
    per_count = STANDARD_GRAVITY_M_S2 / COUNTS_PER_G
    return gravity_from_accelerometer((x * per_count, y * per_count, z * per_count))


class GravityFilter:
    """The mean gravity of the last second. One thread adds readings; any thread may read it."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, Vector]] = deque()
        self._ignored_until_s = -math.inf
        self._mean: tuple[float, Vector] | None = None  # replaced as a whole: needs no lock

    def add(self, gravity: Vector | None, now_s: float, is_moving: bool) -> bool:
        """Add a reading; return False if it cannot be gravity and is ignored.

        While the head moves, earlier readings are discarded because the pose has changed.
        """
        if is_moving or now_s < self._ignored_until_s:
            self.reset()
        if gravity is None or not is_gravity(gravity):
            return False
        self._readings.append((now_s, gravity))
        while self._readings[0][0] < now_s - AVERAGING_WINDOW_S:
            self._readings.popleft()
        x, y, z = zip(*(reading for _, reading in self._readings), strict=True)
        self._mean = (now_s, (fmean(x), fmean(y), fmean(z)))
        return True

    def ignore_until(self, until_s: float) -> None:
        """Discard earlier readings until then, because the head starts to move."""
        self._ignored_until_s = until_s

    def reset(self) -> None:
        """Discard all readings."""
        self._readings.clear()
        self._mean = None

    def mean_at(self, now_s: float) -> Vector | None:
        """Return the mean of the last second; None if the last reading is older. Never waits."""
        mean = self._mean
        return mean[1] if mean is not None and now_s - mean[0] <= AVERAGING_WINDOW_S else None


class MotorUnit:
    """The motor, LED and accelerometer of a camera; this one has none of them.

    Faults are logged once; only methods that say so raise. Settings persist until `close`: they are
    applied again when the motor unit is connected again.

    Attributes:
        is_present: False for a camera without motor unit.
    """

    is_present = False

    @property
    def gravity_m_s2(self) -> Vector | None:
        """Gravity in camera axes over the last second; None while it is unknown."""
        return None

    @property
    def accelerometer(self) -> tuple[AccelerometerReading, ...]:
        """The newest readings, oldest first, with stamps of CLOCK_MONOTONIC; see `RgbdFrame`."""
        return ()

    def open(self, serial: str) -> None:
        """Find the motor unit of the camera `serial` ("" for the only one); measure gravity."""

    def apply(self, settings: SensorConfig) -> None:
        """Set the LED and the tilt, now and after each new connection."""

    def set_led(self, led: Led) -> None:
        """Set the LED. Raises CameraError."""
        raise CameraError("it has no LED")

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head, at most +-31 degrees. Raises CameraError as `set_led` does."""
        raise CameraError("it has no motor")

    def close(self) -> None:
        """Switch the LED off and close. Safe to call twice; `open` may follow."""


TIMEOUT_MS = 500
MAX_TILT_DEG = 31


@dataclass(frozen=True)
class MotorUnitReading:
    """One reading of a motor device.

    Attributes:
        gravity_m_s2: Gravity in camera axes; None if the device gives no data.
        tilt_deg: Tilt of the head against the horizon, up is positive; None while it is unknown.
        is_moving: Whether the motor runs.
    """

    gravity_m_s2: Vector | None
    tilt_deg: float | None
    is_moving: bool


class MotorDevice(Protocol):
    """An open device. Every method raises CameraError, or CameraLostError if it is unplugged."""

    name: str

    def set_led(self, led: Led) -> None:
        """Set the LED."""
        ...

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head; angles are limited to +-31 degrees."""
        ...

    def read(self) -> MotorUnitReading:
        """Read accelerometer and tilt."""
        ...

    def close(self) -> None:
        """Close the device. Never raises."""
        ...


def clamp_tilt_deg(tilt_deg: float) -> float:
    """Limit an angle to the range of the head. Raises ValueError for NaN."""
    if math.isnan(tilt_deg):
        raise ValueError("the tilt is not a number")
    return max(-MAX_TILT_DEG, min(MAX_TILT_DEG, tilt_deg))

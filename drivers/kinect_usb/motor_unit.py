"""What a camera knows of the Kinect's motor, light and accelerometer; free of any USB library."""

import math
from dataclasses import dataclass
from typing import Protocol

from drivers.core.errors import CameraError
from drivers.core.gravity import Vector
from drivers.sensor_config import Led, SensorConfig


class MotorUnit(Protocol):
    """The Kinect's base. Unless it says so nothing raises: trouble is said in the log, once.

    What is set lasts until it is closed: it is done again, or at last, when the base is back.
    """

    is_present: bool  # False: this camera has none

    @property
    def gravity_m_s2(self) -> Vector | None:
        """Gravity in camera axes over the last second; None while it is not known."""
        ...

    def open(self, serial: str) -> None:
        """Find the base of the camera `serial` ("" for the only one) and measure gravity."""
        ...

    def apply(self, settings: SensorConfig) -> None:
        """Switch the light and tilt the head, now and again whenever it was away."""
        ...

    def set_led(self, led: Led) -> None:
        """Switch the light. Raises CameraError if that cannot be done now."""
        ...

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head, +-31 degrees at most. Raises CameraError as `set_led`."""
        ...

    def close(self) -> None:
        """Switch the light off and let go. Safe to call twice; `open` may follow."""
        ...


class NullMotorUnit:
    """For cameras without motor, light and accelerometer."""

    is_present = False
    gravity_m_s2: Vector | None = None

    def open(self, serial: str) -> None:
        """See `MotorUnit`."""

    def apply(self, settings: SensorConfig) -> None:
        """See `MotorUnit`."""

    def set_led(self, led: Led) -> None:
        """Raises CameraError."""
        raise CameraError("it has no light")

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Raises CameraError."""
        raise CameraError("it has no motor")

    def close(self) -> None:
        """See `MotorUnit`."""


TIMEOUT_MS = 500
MAX_TILT_DEG = 31


@dataclass(frozen=True)
class MotorUnitReading:
    """One reading.

    gravity_m_s2  in camera axes; None where the device gives no data
    tilt_deg      of the head against the horizon, up is positive; None while it is not known
    is_moving     the motor runs
    """

    gravity_m_s2: Vector | None
    tilt_deg: float | None
    is_moving: bool


class MotorDevice(Protocol):
    """An open device. Every method raises CameraError, CameraLostError if it is unplugged."""

    name: str

    def set_led(self, led: Led) -> None:
        """Switch the light."""
        ...

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head; angles beyond +-31 degrees are taken as 31."""
        ...

    def read(self) -> MotorUnitReading:
        """Read accelerometer and tilt."""
        ...

    def close(self) -> None:
        """Let go of it. Never raises."""
        ...


def clamp_tilt_deg(tilt_deg: float) -> float:
    """An angle that the head can take. Raises ValueError for NaN."""
    if math.isnan(tilt_deg):
        raise ValueError("the tilt is not a number")
    return max(-MAX_TILT_DEG, min(MAX_TILT_DEG, tilt_deg))

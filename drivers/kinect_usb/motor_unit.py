"""The interface to the Kinect's motor, LED and accelerometer, independent of any USB library."""

import math
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Led, SensorConfig
from drivers.core.errors import CameraError
from drivers.core.geometry import Vector


class MotorUnit(Protocol):
    """The Kinect's motor, LED and accelerometer.

    Faults are logged once; only methods that say so raise. Settings persist until `close`: they are
    applied again when the motor unit is connected again.
    """

    is_present: bool  # False for a camera without motor unit

    @property
    def gravity_m_s2(self) -> Vector | None:
        """Gravity in camera axes over the last second; None while it is unknown."""
        ...

    def open(self, serial: str) -> None:
        """Find the motor unit of the camera `serial` ("" for the only one); measure gravity."""
        ...

    def apply(self, settings: SensorConfig) -> None:
        """Set the LED and the tilt, now and after each new connection."""
        ...

    def set_led(self, led: Led) -> None:
        """Set the LED.

        Raises:
            CameraError: If that is not possible now.
        """
        ...

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Start tilting the head, at most +-31 degrees. Raises CameraError as `set_led` does."""
        ...

    def close(self) -> None:
        """Switch the LED off and close. Safe to call twice; `open` may follow."""
        ...


class NullMotorUnit:
    """The motor unit of a camera without motor, LED and accelerometer."""

    is_present = False
    gravity_m_s2: Vector | None = None

    def open(self, serial: str) -> None:
        pass

    def apply(self, settings: SensorConfig) -> None:
        pass

    def set_led(self, led: Led) -> None:
        """Raise CameraError."""
        raise CameraError("it has no LED")

    def set_tilt_deg(self, tilt_deg: float) -> None:
        """Raise CameraError."""
        raise CameraError("it has no motor")

    def close(self) -> None:
        pass


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
    """Limit an angle to the range of the head.

    Raises:
        ValueError: For NaN.
    """
    if math.isnan(tilt_deg):
        raise ValueError("the tilt is not a number")
    return max(-MAX_TILT_DEG, min(MAX_TILT_DEG, tilt_deg))

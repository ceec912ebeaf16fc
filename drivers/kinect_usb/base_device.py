"""What stands under a Kinect's head, whichever USB device drives it: tilt, light, accelerometer."""

import math
from dataclasses import dataclass
from typing import Protocol

from drivers.gravity import Vector
from drivers.sensor_settings import Led

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

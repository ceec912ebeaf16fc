"""What a camera knows of the Kinect's motor, light and accelerometer; free of any USB library."""

from typing import Protocol

from drivers.gravity import Vector
from drivers.sensor_settings import SensorSettings


class Base(Protocol):
    """The Kinect's base. Nothing of it raises: trouble is said in the log, once."""

    @property
    def gravity_m_s2(self) -> Vector | None:
        """Gravity in camera axes over the last second; None while it is not known."""
        ...

    def open(self, serial: str) -> None:
        """Find the base of the camera `serial` ("" for the only one) and measure gravity."""
        ...

    def apply(self, settings: SensorSettings) -> None:
        """Switch the light and tilt the head, now and again whenever it was away."""
        ...

    def close(self) -> None:
        """Switch the light off and let go. Safe to call twice; `open` may follow."""
        ...


class NoBase:
    """For cameras without motor, light and accelerometer."""

    gravity_m_s2: Vector | None = None

    def open(self, serial: str) -> None:
        """See `Base`."""

    def apply(self, settings: SensorSettings) -> None:
        """See `Base`."""

    def close(self) -> None:
        """See `Base`."""

"""Requests to a running camera, passed on to its worker process."""

from dataclasses import dataclass

from drivers.camera import RgbdCamera
from drivers.sensor_config import Led


@dataclass(frozen=True)
class SetTilt:
    """Tilt the head, see `RgbdCamera.set_tilt_deg`."""

    tilt_deg: float

    def apply(self, camera: RgbdCamera) -> None:
        """Apply the request. Raises CameraError if that is not possible now."""
        camera.set_tilt_deg(self.tilt_deg)


@dataclass(frozen=True)
class SetLed:
    """Set the LED, see `RgbdCamera.set_led`."""

    led: Led

    def apply(self, camera: RgbdCamera) -> None:
        """Apply the request. Raises CameraError if that is not possible now."""
        camera.set_led(self.led)


DeviceRequest = SetTilt | SetLed

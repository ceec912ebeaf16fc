"""What may be asked of a camera while it works; it is passed on to the driver's process."""

from dataclasses import dataclass

from drivers.camera import RgbdCamera
from drivers.sensor_config import Led


@dataclass(frozen=True)
class SetTilt:
    """See `RgbdCamera.set_tilt_deg`."""

    tilt_deg: float

    def apply(self, camera: RgbdCamera) -> None:
        """Raises CameraError if it cannot be done now."""
        camera.set_tilt_deg(self.tilt_deg)


@dataclass(frozen=True)
class SetLed:
    """See `RgbdCamera.set_led`."""

    led: Led

    def apply(self, camera: RgbdCamera) -> None:
        """Raises CameraError if it cannot be done now."""
        camera.set_led(self.led)


DeviceRequest = SetTilt | SetLed

"""What libusb says of the sensors on the bus."""

import errno
from dataclasses import dataclass
from enum import StrEnum

import usb.core
import usb.util

from drivers.kinect_usb.devices import Part, Sensor, find_sensors
from drivers.kinect_usb.ids import Model, Role
from vo_service.doctor.child import in_child

VIDEO_INTERFACE = 0
LIMIT_S = 15.0


class Refusal(StrEnum):
    """Why the camera cannot be had now."""

    NONE = "none"
    PERMISSION = "permission"
    BUSY = "busy"
    GONE = "gone"
    OTHER = "other"


_REFUSALS = {
    errno.EACCES: Refusal.PERMISSION,
    errno.EPERM: Refusal.PERMISSION,
    errno.EBUSY: Refusal.BUSY,
    errno.ENODEV: Refusal.GONE,
    errno.ENOENT: Refusal.GONE,
}


@dataclass(frozen=True)
class UsbPart:
    """One USB device of a sensor."""

    id_text: str  # "045e:02ae"
    role: Role
    bus: int
    address: int


@dataclass(frozen=True)
class UsbSensor:
    """A sensor as libusb sees it.

    serial            "" where it cannot be read
    speed_mbit_s      None where libusb does not tell
    refusal           of the camera; its text is libusb's
    kernel_driver     True if the kernel's own driver has the camera, None if that is not known
    audio_interfaces  2 or more once the audio device has its firmware; None without that device
    """

    model: Model
    is_supported: bool
    camera: UsbPart
    others: tuple[UsbPart, ...]
    where: str
    serial: str = ""
    speed_mbit_s: float | None = None
    refusal: Refusal = Refusal.NONE
    refusal_text: str = ""
    kernel_driver: bool | None = None
    audio_interfaces: int | None = None


def sensors_on_usb() -> tuple[UsbSensor, ...]:
    """Every sensor on the bus, found out in a child, as libusb may hang or crash.

    Raises UserFacingError if libusb is missing or does not work.
    """
    return in_child(look_at_usb, LIMIT_S)


def look_at_usb() -> tuple[UsbSensor, ...]:
    """The same, in this very process."""
    return tuple(_facts(sensor) for sensor in find_sensors())


def _facts(sensor: Sensor) -> UsbSensor:
    kernel_driver, refusal, text = _try(sensor.camera) if sensor.is_supported else _NOT_TRIED
    return UsbSensor(
        model=sensor.model,
        is_supported=sensor.is_supported,
        camera=_part(sensor.camera),
        others=tuple(_part(part) for part in sensor.others),
        where=sensor.camera.where,
        serial=sensor.read_serial() if refusal is not Refusal.PERMISSION else "",
        speed_mbit_s=sensor.camera.speed_mbit_s,
        refusal=refusal,
        refusal_text=text,
        kernel_driver=kernel_driver,
        audio_interfaces=_audio_interfaces(sensor),
    )


_NOT_TRIED = (None, Refusal.NONE, "")


def _part(part: Part) -> UsbPart:
    product = int(part.handle.idProduct)
    return UsbPart(f"{part.id.vendor:04x}:{product:04x}", part.id.role, part.bus, part.address)


def _try(camera: Part) -> tuple[bool | None, Refusal, str]:
    """Open and claim the camera for a moment. A kernel driver is let be: the stream detaches it."""
    device = camera.handle
    try:
        if _has_kernel_driver(device):
            return True, Refusal.NONE, ""
        usb.util.claim_interface(device, VIDEO_INTERFACE)
        usb.util.release_interface(device, VIDEO_INTERFACE)
    except usb.core.USBError as error:
        refusal = _REFUSALS.get(error.errno or 0, Refusal.OTHER)
        return None, refusal, error.strerror or str(error)
    finally:
        usb.util.dispose_resources(device)
    return False, Refusal.NONE, ""


def _has_kernel_driver(device: usb.core.Device) -> bool:
    try:
        return bool(device.is_kernel_driver_active(VIDEO_INTERFACE))
    except NotImplementedError:
        return False


def _audio_interfaces(sensor: Sensor) -> int | None:
    audio = next((part for part in sensor.others if part.id.role is Role.AUDIO), None)
    if audio is None:
        return None
    try:
        return int(audio.handle[0].bNumInterfaces)
    except (usb.core.USBError, IndexError):
        return None

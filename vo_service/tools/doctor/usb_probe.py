"""Sensors on the USB as libusb reports them."""

import errno
from dataclasses import dataclass
from enum import StrEnum

import usb.core
import usb.util

from drivers.kinect_usb.usb_devices import ConnectedSensor, UsbDevice, find_connected_sensors
from drivers.kinect_usb.usb_ids import SensorModel, UsbRole
from vo_service.tools.doctor.subprocess_call import call_in_subprocess

VIDEO_INTERFACE = 0
USB_TIMEOUT_S = 15.0


class OpenError(StrEnum):
    """Reason why the camera cannot be opened now."""

    NONE = "none"
    PERMISSION = "permission"
    BUSY = "busy"
    GONE = "gone"
    OTHER = "other"


_OPEN_ERRORS = {
    errno.EACCES: OpenError.PERMISSION,
    errno.EPERM: OpenError.PERMISSION,
    errno.EBUSY: OpenError.BUSY,
    errno.ENODEV: OpenError.GONE,
    errno.ENOENT: OpenError.GONE,
}


@dataclass(frozen=True)
class UsbPart:
    """One USB device of a sensor."""

    id_text: str  # "045e:02ae"
    role: UsbRole
    bus: int
    address: int


@dataclass(frozen=True)
class UsbSensor:
    """A sensor as libusb reports it.

    Attributes:
        model: Model of the sensor.
        is_supported: Whether a driver exists for it.
        camera: Its camera device.
        others: Its other USB devices.
        where: Bus and port, as text.
        serial: Serial number; "" if not readable.
        speed_mbit_s: Speed of the USB link; None if not known.
        open_error: Why the camera cannot be opened.
        open_error_text: libusb's text for it.
        has_kernel_driver: Whether a kernel driver has the camera; None if not known.
        audio_interfaces: 2 or more once the audio device has its firmware; None without the device.
    """

    model: SensorModel
    is_supported: bool
    camera: UsbPart
    others: tuple[UsbPart, ...]
    where: str
    serial: str = ""
    speed_mbit_s: float | None = None
    open_error: OpenError = OpenError.NONE
    open_error_text: str = ""
    has_kernel_driver: bool | None = None
    audio_interfaces: int | None = None


def probe_usb() -> tuple[UsbSensor, ...]:
    """List the sensors on the bus, in a subprocess because libusb may hang or crash.

    Raises:
        UserFacingError: libusb is missing or does not work.
    """
    return call_in_subprocess(probe_usb_in_process, USB_TIMEOUT_S)


def probe_usb_in_process() -> tuple[UsbSensor, ...]:
    """List the sensors on the bus, in this process."""
    return tuple(_probe_sensor(sensor) for sensor in find_connected_sensors())


def _probe_sensor(sensor: ConnectedSensor) -> UsbSensor:
    kernel_driver, open_error, text = (
        _try_open(sensor.camera) if sensor.is_supported else _NOT_TRIED
    )
    return UsbSensor(
        model=sensor.model,
        is_supported=sensor.is_supported,
        camera=_make_part(sensor.camera),
        others=tuple(_make_part(part) for part in sensor.other_devices),
        where=sensor.camera.location,
        serial=sensor.read_serial() if open_error is not OpenError.PERMISSION else "",
        speed_mbit_s=sensor.camera.speed_mbit_s,
        open_error=open_error,
        open_error_text=text,
        has_kernel_driver=kernel_driver,
        audio_interfaces=_audio_interfaces(sensor),
    )


_NOT_TRIED = (None, OpenError.NONE, "")


def _make_part(part: UsbDevice) -> UsbPart:
    product = int(part.handle.idProduct)
    return UsbPart(f"{part.id.vendor:04x}:{product:04x}", part.id.role, part.bus, part.address)


def _try_open(camera: UsbDevice) -> tuple[bool | None, OpenError, str]:
    """Open, claim and release the camera. Leaves a kernel driver, which the stream detaches."""
    device = camera.handle
    try:
        if _has_kernel_driver(device):
            return True, OpenError.NONE, ""
        usb.util.claim_interface(device, VIDEO_INTERFACE)
        usb.util.release_interface(device, VIDEO_INTERFACE)
    except usb.core.USBError as error:
        open_error = _OPEN_ERRORS.get(error.errno or 0, OpenError.OTHER)
        return None, open_error, error.strerror or str(error)
    finally:
        usb.util.dispose_resources(device)
    return False, OpenError.NONE, ""


def _has_kernel_driver(device: usb.core.Device) -> bool:
    try:
        return bool(device.is_kernel_driver_active(VIDEO_INTERFACE))
    except NotImplementedError:
        return False


def _audio_interfaces(sensor: ConnectedSensor) -> int | None:
    audio = next((part for part in sensor.other_devices if part.id.role is UsbRole.AUDIO), None)
    if audio is None:
        return None
    try:
        return int(audio.handle[0].bNumInterfaces)
    except (usb.core.USBError, IndexError):
        return None

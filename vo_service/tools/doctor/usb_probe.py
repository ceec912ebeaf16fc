"""Sensors on the USB as libusb reports them, and USB devices as the kernel lists them."""

import errno
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import usb.core
import usb.util

from drivers.kinect_usb.usb_devices import ConnectedSensor, UsbDevice, find_connected_sensors
from drivers.kinect_usb.usb_ids import SensorModel, UsbRole, is_supported
from vo_service.tools.doctor.stream_probe import call_in_subprocess

HUB_CLASS = "09"
_ROOT_HUB = re.compile(r"usb\d+")
VIDEO_INTERFACE = 0
USB_TIMEOUT_S = 15.0


@dataclass(frozen=True)
class KernelUsbDevice:
    """One USB device; `path` has no symbolic links."""

    path: Path

    def attribute(self, name: str) -> str:
        """Return the text of an attribute, or "" if it does not exist."""
        return _read_text(self.path / name)

    @property
    def bus_and_address(self) -> tuple[str, str]:
        """Bus and address as texts."""
        return self.attribute("busnum"), self.attribute("devnum")

    @property
    def controller(self) -> str:
        """Name of the host controller, such as 0000:00:14.0; "" if not known."""
        roots = [folder for folder in self.path.parents if _ROOT_HUB.fullmatch(folder.name)]
        return roots[0].parent.name if roots else ""

    @property
    def name(self) -> str:
        """Manufacturer, product and ids."""
        words = [self.attribute("manufacturer"), self.attribute("product")]
        ids = f"{self.attribute('idVendor')}:{self.attribute('idProduct')}"
        return " ".join(word for word in [*words, ids] if word)

    @property
    def is_hub(self) -> bool:
        """True for a hub, including the controller's root hub."""
        return self.attribute("bDeviceClass") == HUB_CLASS

    @property
    def interfaces(self) -> list[Path]:
        """Folders of its interfaces."""
        return sorted(self.path.glob(f"{self.path.name}:*"))

    @property
    def interface_classes(self) -> set[str]:
        """Interface classes, two hexadecimal digits: 01 audio, 03 input, 08 storage, 0e video."""
        return {_read_text(folder / "bInterfaceClass") for folder in self.interfaces}

    @property
    def drivers(self) -> list[str]:
        """Kernel drivers of its interfaces; "usbfs" means that a program has claimed one."""
        links = [folder / "driver" for folder in self.interfaces]
        return sorted({link.resolve().name for link in links if link.is_symlink()})

    @property
    def video_nodes(self) -> list[str]:
        """Names of its webcam devices in /dev."""
        return sorted(path.name for path in self.path.glob("*/video4linux/video*"))


def list_usb_devices(root: Path) -> list[KernelUsbDevice]:
    """List all devices and hubs below /sys; empty if the kernel lists no USB."""
    try:
        links = sorted((root / "sys/bus/usb/devices").iterdir())
    except OSError:
        return []
    return [KernelUsbDevice(link.resolve()) for link in links if (link / "idVendor").exists()]


def _read_text(path: Path) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return ""


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

    bus: int
    address: int

    @property
    def bus_and_address(self) -> tuple[str, str]:
        """Bus and address as texts, as of the kernel's entry."""
        return str(self.bus), str(self.address)


@dataclass(frozen=True)
class UsbSensor:
    """A sensor as libusb reports it.

    Attributes:
        others: Its other USB devices than the camera.
        where: Bus and port, as text.
        serial: Serial number; "" if not readable.
        speed_mbit_s: Speed of the USB link; None if not known.
        open_error: Why the camera cannot be opened.
        open_error_text: libusb's text for it.
        has_kernel_driver: Whether a kernel driver has the camera; None if not known.
        audio_interfaces: 2 or more once the audio device has its firmware; None without the device.
    """

    model: SensorModel
    camera: UsbPart
    others: tuple[UsbPart, ...]
    where: str
    serial: str = ""
    speed_mbit_s: float | None = None
    open_error: OpenError = OpenError.NONE
    open_error_text: str = ""
    has_kernel_driver: bool | None = None
    audio_interfaces: int | None = None

    @property
    def is_supported(self) -> bool:
        """Whether a driver exists for it."""
        return is_supported(self.model)


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
        _try_open(sensor.camera) if sensor.is_supported else (None, OpenError.NONE, "")
    )
    camera, *others = (
        UsbPart(device.bus, device.address) for device in (sensor.camera, *sensor.other_devices)
    )
    return UsbSensor(
        model=sensor.model,
        camera=camera,
        others=tuple(others),
        where=sensor.camera.location,
        serial=sensor.read_serial() if open_error is not OpenError.PERMISSION else "",
        speed_mbit_s=sensor.camera.speed_mbit_s,
        open_error=open_error,
        open_error_text=text,
        has_kernel_driver=kernel_driver,
        audio_interfaces=_audio_interfaces(sensor),
    )


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

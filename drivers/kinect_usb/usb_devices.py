"""Detection of connected sensors: their USB devices, grouped by sensor, and hot-plug."""

import errno
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import usb.core
import usb.util

from drivers.camera import is_serial
from drivers.core import CameraError, CameraLostError, CameraNotFoundError, UserFacingError
from drivers.kinect_usb.motor_unit import TIMEOUT_MS
from drivers.kinect_usb.usb_ids import (
    REVISION_1414,
    SensorModel,
    UsbId,
    UsbRole,
    find_usb_id,
    is_kinect,
    is_supported,
)


@contextmanager
def translate_usb_errors(device_name: str) -> Iterator[None]:
    """Turn pyusb's errors in the block into errors about the device.

    Raises:
        CameraLostError: The device was unplugged.
        CameraError: Another error of the device.
        UserFacingError: libusb is not installed.
    """
    try:
        yield
    except usb.core.NoBackendError as error:
        raise UserFacingError(
            "libusb-1.0.so.0 is not installed, so no Kinect can be found; apt install libusb-1.0-0"
        ) from error
    except (usb.core.USBError, NotImplementedError) as error:
        raise _camera_error(device_name, error) from error


def _camera_error(device_name: str, error: Exception) -> CameraError:
    number = getattr(error, "errno", None)
    if number in (errno.ENODEV, errno.ENOENT):
        return CameraLostError(f"{device_name}: unplugged; plug it in again")
    if number in (errno.EACCES, errno.EPERM):
        return CameraError(f"{device_name}: no permission; kinect-vo doctor shows how to get it")
    if number == errno.EBUSY:
        return CameraError(f"{device_name}: in use by another program; close that first")
    if isinstance(error, usb.core.USBTimeoutError):
        return CameraError(f"{device_name}: does not answer; unplug it and plug it in again")
    return CameraError(f"{device_name}: {error}; unplug it and plug it in again")


SPEEDS_MBIT_S = {
    usb.util.SPEED_LOW: 1.5,
    usb.util.SPEED_FULL: 12.0,
    usb.util.SPEED_HIGH: 480.0,
    usb.util.SPEED_SUPER: 5000.0,
}


@dataclass(frozen=True)
class UsbDevice:
    """One USB device of a sensor.

    Attributes:
        model: The first of those that share the id, unless the part belongs to a `Sensor`.
        ports: From the root hub's port outwards; () where the system does not tell.
        speed_mbit_s: That it was connected with; None where the system does not tell.
        handle: Pyusb's object, not opened.
    """

    id: UsbId
    model: SensorModel
    bus: int
    address: int
    ports: tuple[int, ...]
    speed_mbit_s: float | None
    handle: usb.core.Device = field(repr=False, compare=False)

    @property
    def location(self) -> str:
        """The place for messages: ``bus 1 port 2.1``."""
        if not self.ports:
            return f"bus {self.bus} device {self.address}"
        return f"bus {self.bus} port {'.'.join(map(str, self.ports))}"

    @property
    def hub_path(self) -> tuple[int, ...]:
        """Bus and ports of its hub, which all devices of one sensor share."""
        return (self.bus, *self.ports[:-1])

    def read_serial(self) -> str:
        """Read the serial number; "" if there is none or the device may not be opened."""
        self.handle.default_timeout = TIMEOUT_MS
        try:
            serial = self.handle.serial_number
        except (usb.core.USBError, ValueError, NotImplementedError):
            return ""  # pyusb raises ValueError without permission
        finally:
            usb.util.dispose_resources(self.handle)
        return str(serial or "").strip("\0")


@dataclass(frozen=True)
class ConnectedSensor:
    """A sensor: its camera and its other USB devices."""

    camera: UsbDevice
    other_devices: tuple[UsbDevice, ...] = ()

    @property
    def model(self) -> SensorModel:
        """The model, as its camera identifies it."""
        return self.camera.model

    @property
    def is_supported(self) -> bool:
        """False for a Kinect v2 or an Azure Kinect."""
        return is_supported(self.model)

    @property
    def name(self) -> str:
        """Model and place, for messages."""
        return f"{self.model} ({self.camera.location})"

    @property
    def motor_device(self) -> UsbDevice | None:
        """The device with motor, LED and accelerometer; None if there is none."""
        role = UsbRole.MOTOR if self.model is SensorModel.K1414 else UsbRole.AUDIO
        return next((device for device in self.other_devices if device.id.role is role), None)

    def read_serial(self) -> str:
        """Read the serial number that libfreenect uses: the camera's, else the audio device's."""
        camera_serial = self.camera.read_serial()
        if is_serial(camera_serial):
            return camera_serial
        audio = [device for device in self.other_devices if device.id.role is UsbRole.AUDIO]
        return next((serial for device in audio if (serial := device.read_serial())), camera_serial)


def find_usb_devices() -> list[UsbDevice]:
    """Find the USB devices of all known sensors, supported or not, without opening them.

    Raises:
        UserFacingError: libusb is not installed.
        CameraError: libusb cannot list the devices.
    """
    with translate_usb_errors("the USB"):
        handles = list(usb.core.find(find_all=True) or ())
    usb_ids = [(find_usb_id(handle.idVendor, handle.idProduct), handle) for handle in handles]
    devices = [_make_usb_device(usb_id, handle) for usb_id, handle in usb_ids if usb_id is not None]
    return sorted(devices, key=lambda device: (device.bus, device.ports, device.address))


def find_connected_sensors() -> list[ConnectedSensor]:
    """Find all connected sensors in the order of their places; errors as `find_usb_devices`."""
    return group_by_sensor(find_usb_devices())


def find_kinect(serial: str) -> ConnectedSensor:
    """Find the Kinect with this serial number, or the first one for "".

    Serial numbers are read only if there are several Kinects.

    Raises:
        CameraNotFoundError: There is none. Other errors are those of `find_usb_devices`.
    """
    kinects = [sensor for sensor in find_connected_sensors() if is_kinect(sensor.model)]
    if serial and len(kinects) > 1:
        kinects = [kinect for kinect in kinects if kinect.read_serial() == serial]
    if not kinects:
        name = f"no Kinect {serial}" if serial else "no Kinect"
        raise CameraNotFoundError(f"{name} on the USB; plug it in, and its own power supply too")
    return kinects[0]


def group_by_sensor(devices: Sequence[UsbDevice]) -> list[ConnectedSensor]:
    """Group each camera with the other devices on its hub: a Kinect contains a hub.

    The camera determines the model, because two models share the ids of the other devices.
    """
    cameras = [device for device in devices if device.id.role is UsbRole.CAMERA]
    others = [device for device in devices if device.id.role is not UsbRole.CAMERA]
    return [
        ConnectedSensor(
            camera,
            tuple(
                replace(device, model=camera.model)
                for device in others
                if device.hub_path == camera.hub_path
            ),
        )
        for camera in cameras
    ]


def _make_usb_device(usb_id: UsbId, device: usb.core.Device) -> UsbDevice:
    is_camera = usb_id.model is SensorModel.K1414 and usb_id.role is UsbRole.CAMERA
    is_1473 = is_camera and device.bcdDevice != REVISION_1414
    return UsbDevice(
        id=usb_id,
        model=SensorModel.K1473 if is_1473 else usb_id.model,
        bus=int(device.bus or 0),
        address=int(device.address or 0),
        ports=tuple(device.port_numbers or ()),
        speed_mbit_s=SPEEDS_MBIT_S.get(device.speed),
        handle=device,
    )


def open_udev_monitor() -> Any:
    """Open a pyudev monitor of USB devices; udev has set their permissions before an event.

    Raises:
        ImportError: libudev is not installed.
        OSError: There is no netlink, as in some containers.
    """
    import pyudev

    monitor = pyudev.Monitor.from_netlink(pyudev.Context())
    monitor.filter_by("usb", "usb_device")
    monitor.start()
    return monitor


def wait_for_device(timeout_s: float, open_monitor: Callable[[], Any] = open_udev_monitor) -> bool:
    """Wait until a supported sensor's camera is plugged in, at most `timeout_s`.

    Without udev it sleeps for the whole time.

    Returns:
        Whether one was plugged in.
    """
    deadline_s = time.monotonic() + timeout_s
    try:
        monitor = open_monitor()
        while (remaining_s := deadline_s - time.monotonic()) > 0:
            event = monitor.poll(timeout=remaining_s)
            if event is not None and _is_new_camera(event):
                return True
    except (ImportError, OSError, ValueError):  # no udev, or an event that cannot be parsed
        time.sleep(max(0.0, deadline_s - time.monotonic()))
    return False


def _is_new_camera(event: Any) -> bool:
    """Whether a supported camera was added; PRODUCT=45e/2ae/10b is vendor/product/revision."""
    vendor, product, *_ = event.properties.get("PRODUCT", "0/0").split("/")
    usb_id = find_usb_id(int(vendor, 16), int(product, 16))
    if event.action != "add" or usb_id is None:
        return False
    return usb_id.role is UsbRole.CAMERA and is_supported(usb_id.model)

"""Which sensors are plugged in: their parts on the USB, put together."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import usb.core
import usb.util

from drivers.core.errors import CameraNotFoundError
from drivers.kinect_usb.motor_unit import TIMEOUT_MS
from drivers.kinect_usb.usb_errors import translate_usb_errors
from drivers.kinect_usb.usb_ids import (
    REVISION_1414,
    SensorModel,
    UsbId,
    UsbRole,
    find_usb_id,
    is_kinect,
    is_supported,
)

SPEEDS_MBIT_S = {
    usb.util.SPEED_LOW: 1.5,
    usb.util.SPEED_FULL: 12.0,
    usb.util.SPEED_HIGH: 480.0,
    usb.util.SPEED_SUPER: 5000.0,
}


@dataclass(frozen=True)
class UsbDevice:
    """One USB device of a sensor.

    model         the first of those that share the id, unless the part belongs to a `Sensor`
    ports         from the root hub's port outwards; () where the system does not tell
    speed_mbit_s  that it was connected with; None where the system does not tell
    handle        pyusb's object, not opened
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
        """For people: ``bus 1 port 2.1``."""
        if not self.ports:
            return f"bus {self.bus} device {self.address}"
        return f"bus {self.bus} port {'.'.join(map(str, self.ports))}"

    @property
    def hub_path(self) -> tuple[int, ...]:
        """Bus and ports of the hub that it hangs on: the parts of one sensor share it."""
        return (self.bus, *self.ports[:-1])

    def read_serial(self) -> str:
        """Ask the device for its serial number; "" if it has none or may not be opened."""
        self.handle.default_timeout = TIMEOUT_MS
        try:
            serial = self.handle.serial_number
        except (usb.core.USBError, ValueError, NotImplementedError):
            return ""  # pyusb raises ValueError where it may not ask
        finally:
            usb.util.dispose_resources(self.handle)
        return str(serial or "").strip("\0")


@dataclass(frozen=True)
class ConnectedSensor:
    """A camera with whatever belongs to it."""

    camera: UsbDevice
    other_devices: tuple[UsbDevice, ...] = ()

    @property
    def model(self) -> SensorModel:
        """Which one it is."""
        return self.camera.model

    @property
    def is_supported(self) -> bool:
        """False for a Kinect v2 or an Azure Kinect."""
        return is_supported(self.model)

    @property
    def name(self) -> str:
        """For people: model and place."""
        return f"{self.model} ({self.camera.location})"

    @property
    def motor_device(self) -> UsbDevice | None:
        """The part with motor, light and accelerometer; None for a sensor without or not seen."""
        role = UsbRole.MOTOR if self.model is SensorModel.K1414 else UsbRole.AUDIO
        return next((part for part in self.other_devices if part.id.role is role), None)

    def read_serial(self) -> str:
        """The number that libfreenect knows it by: where the camera has none, the audio's."""
        serial = self.camera.read_serial()
        if serial.strip("0"):
            return serial
        audio = [part for part in self.other_devices if part.id.role is UsbRole.AUDIO]
        return next((found for part in audio if (found := part.read_serial())), serial)


def find_usb_devices() -> list[UsbDevice]:
    """Every USB device of a sensor that is known, supported or not; none of them is opened.

    Raises UserFacingError if libusb is not installed, CameraError if it cannot list the devices.
    """
    with translate_usb_errors("the USB"):
        found = list(usb.core.find(find_all=True) or ())
    known = [(find_usb_id(device.idVendor, device.idProduct), device) for device in found]
    parts = [_make_usb_device(line, device) for line, device in known if line is not None]
    return sorted(parts, key=lambda part: (part.bus, part.ports, part.address))


def find_connected_sensors() -> list[ConnectedSensor]:
    """Every sensor plugged in, as `find_usb_devices`, in the order of their places."""
    return group_by_sensor(find_usb_devices())


def find_kinect(serial: str) -> ConnectedSensor:
    """The Kinect of this serial number; the first one for "".

    Serial numbers are asked for only where there is a choice.
    Raises CameraNotFoundError if there is none, otherwise as `find_usb_devices`.
    """
    kinects = [sensor for sensor in find_connected_sensors() if is_kinect(sensor.model)]
    if serial and len(kinects) > 1:
        kinects = [kinect for kinect in kinects if kinect.read_serial() == serial]
    if not kinects:
        wanted = f"no Kinect {serial}" if serial else "no Kinect"
        raise CameraNotFoundError(f"{wanted} on the USB; plug it in, and its own power supply too")
    return kinects[0]


def group_by_sensor(devices: Sequence[UsbDevice]) -> list[ConnectedSensor]:
    """Put cameras together with what hangs on the same hub: a Kinect has one inside.

    The camera says which model all of them are; the ids of the others are shared by two.
    """
    cameras = [part for part in devices if part.id.role is UsbRole.CAMERA]
    others = [part for part in devices if part.id.role is not UsbRole.CAMERA]
    return [
        ConnectedSensor(
            camera,
            tuple(
                replace(part, model=camera.model)
                for part in others
                if part.hub_path == camera.hub_path
            ),
        )
        for camera in cameras
    ]


def _make_usb_device(usb_id: UsbId, device: usb.core.Device) -> UsbDevice:
    newer = usb_id.model is SensorModel.K1414 and usb_id.role is UsbRole.CAMERA
    return UsbDevice(
        id=usb_id,
        model=SensorModel.K1473 if newer and device.bcdDevice != REVISION_1414 else usb_id.model,
        bus=int(device.bus or 0),
        address=int(device.address or 0),
        ports=tuple(device.port_numbers or ()),
        speed_mbit_s=SPEEDS_MBIT_S.get(device.speed),
        handle=device,
    )

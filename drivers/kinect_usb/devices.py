"""Which sensors are plugged in: their parts on the USB, put together."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import usb.core
import usb.util

from drivers.errors import CameraNotFoundError
from drivers.kinect_usb.base_device import TIMEOUT_MS
from drivers.kinect_usb.errors import usb_errors_of
from drivers.kinect_usb.ids import (
    REVISION_1414,
    Model,
    Role,
    UsbId,
    is_kinect,
    is_supported,
    known_id,
)

MEGABITS_A_SECOND = {
    usb.util.SPEED_LOW: 1.5,
    usb.util.SPEED_FULL: 12.0,
    usb.util.SPEED_HIGH: 480.0,
    usb.util.SPEED_SUPER: 5000.0,
}


@dataclass(frozen=True)
class Part:
    """One USB device of a sensor.

    model         the first of those that share the id, unless the part belongs to a `Sensor`
    ports         from the root hub's port outwards; () where the system does not tell
    speed_mbit_s  that it was connected with; None where the system does not tell
    handle        pyusb's object, not opened
    """

    id: UsbId
    model: Model
    bus: int
    address: int
    ports: tuple[int, ...]
    speed_mbit_s: float | None
    handle: usb.core.Device = field(repr=False, compare=False)

    @property
    def where(self) -> str:
        """For people: ``bus 1 port 2.1``."""
        if not self.ports:
            return f"bus {self.bus} device {self.address}"
        return f"bus {self.bus} port {'.'.join(map(str, self.ports))}"

    @property
    def hub(self) -> tuple[int, ...]:
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
class Sensor:
    """A camera with whatever belongs to it."""

    camera: Part
    others: tuple[Part, ...] = ()

    @property
    def model(self) -> Model:
        """Which one it is."""
        return self.camera.model

    @property
    def is_supported(self) -> bool:
        """False for a Kinect v2 or an Azure Kinect."""
        return is_supported(self.model)

    @property
    def name(self) -> str:
        """For people: model and place."""
        return f"{self.model} ({self.camera.where})"

    @property
    def base(self) -> Part | None:
        """The part with motor, light and accelerometer; None for a sensor without or not seen."""
        role = Role.MOTOR if self.model is Model.K1414 else Role.AUDIO
        return next((part for part in self.others if part.id.role is role), None)

    def read_serial(self) -> str:
        """The number that libfreenect knows it by: where the camera has none, the audio's."""
        serial = self.camera.read_serial()
        if serial.strip("0"):
            return serial
        audio = [part for part in self.others if part.id.role is Role.AUDIO]
        return next((found for part in audio if (found := part.read_serial())), serial)


def find_parts() -> list[Part]:
    """Every USB device of a sensor that is known, supported or not; none of them is opened.

    Raises UserFacingError if libusb is not installed, CameraError if it cannot list the devices.
    """
    with usb_errors_of("the USB"):
        found = list(usb.core.find(find_all=True) or ())
    known = [(known_id(device.idVendor, device.idProduct), device) for device in found]
    parts = [_part(line, device) for line, device in known if line is not None]
    return sorted(parts, key=lambda part: (part.bus, part.ports, part.address))


def find_sensors() -> list[Sensor]:
    """Every sensor plugged in, as `find_parts`, in the order of their places."""
    return grouped(find_parts())


def find_kinect(serial: str) -> Sensor:
    """The Kinect of this serial number; the first one for "".

    Serial numbers are asked for only where there is a choice.
    Raises CameraNotFoundError if there is none, otherwise as `find_parts`.
    """
    kinects = [sensor for sensor in find_sensors() if is_kinect(sensor.model)]
    if serial and len(kinects) > 1:
        kinects = [kinect for kinect in kinects if kinect.read_serial() == serial]
    if not kinects:
        wanted = f"no Kinect {serial}" if serial else "no Kinect"
        raise CameraNotFoundError(f"{wanted} on the USB; plug it in, and its own power supply too")
    return kinects[0]


def grouped(parts: Sequence[Part]) -> list[Sensor]:
    """Put cameras together with what hangs on the same hub: a Kinect has one inside.

    The camera says which model all of them are; the ids of the others are shared by two.
    """
    cameras = [part for part in parts if part.id.role is Role.CAMERA]
    others = [part for part in parts if part.id.role is not Role.CAMERA]
    return [
        Sensor(
            camera,
            tuple(replace(part, model=camera.model) for part in others if part.hub == camera.hub),
        )
        for camera in cameras
    ]


def _part(line: UsbId, device: usb.core.Device) -> Part:
    newer = line.model is Model.K1414 and line.role is Role.CAMERA
    return Part(
        id=line,
        model=Model.K1473 if newer and device.bcdDevice != REVISION_1414 else line.model,
        bus=int(device.bus or 0),
        address=int(device.address or 0),
        ports=tuple(device.port_numbers or ()),
        speed_mbit_s=MEGABITS_A_SECOND.get(device.speed),
        handle=device,
    )

"""Which cameras --camera can name now, from what libusb and libOpenNI2 see."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from drivers.errors import UserFacingError
from drivers.openni2.device import FoundDevice
from drivers.openni2.finding import list_devices
from vo_service.doctor.checks import KINECTS, PRIMESENSES
from vo_service.doctor.child import in_child
from vo_service.doctor.usb_facts import Refusal, UsbSensor

LIMIT_S = 15.0
_TROUBLES = {
    Refusal.NONE: "",
    Refusal.PERMISSION: "this user may not open it",
    Refusal.BUSY: "another program has it",
    Refusal.GONE: "it has just been unplugged",
}


@dataclass(frozen=True)
class Openable:
    """One sensor.

    camera   what to give to --camera; "" for a sensor that is not supported
    trouble  why it cannot be opened now; "" where nothing speaks against it
    """

    camera: str
    name: str
    where: str
    serial: str
    trouble: str

    def as_json(self) -> dict[str, str]:
        """The keys stay."""
        return asdict(self)


def openable(sensors: Sequence[UsbSensor], openni2: "OpenNI2Devices") -> list[Openable]:
    """Every sensor there is, those that OpenNI2 drives as it names them."""
    kinects = [sensor for sensor in sensors if sensor.model in KINECTS]
    unsupported = [sensor for sensor in sensors if not sensor.is_supported]
    seen_by_usb = [sensor for sensor in sensors if sensor.model in PRIMESENSES]
    return [
        *(_kinect(sensor) for sensor in kinects),
        *(_primesense(device) for device in openni2.devices),
        *(_unseen(sensor, openni2) for sensor in seen_by_usb[len(openni2.devices) :]),
        *(_unsupported(sensor) for sensor in unsupported),
    ]


@dataclass(frozen=True)
class OpenNI2Devices:
    """What libOpenNI2 sees, and why it sees nothing where it does not work."""

    devices: tuple[FoundDevice, ...] = ()
    trouble: str = ""


def look_with_openni2() -> OpenNI2Devices:
    """Ask libOpenNI2, in a child."""
    try:
        return OpenNI2Devices(in_child(_ask_openni2, LIMIT_S))
    except UserFacingError as error:
        return OpenNI2Devices((), str(error))


def _ask_openni2() -> tuple[FoundDevice, ...]:
    return tuple(list_devices())


def _kinect(sensor: UsbSensor) -> Openable:
    has_serial = bool(sensor.serial.strip("0"))
    return Openable(
        camera=f"freenect:{sensor.serial}" if has_serial else "freenect",
        name=sensor.model,
        where=sensor.where,
        serial=sensor.serial if has_serial else "",
        trouble=_TROUBLES.get(sensor.refusal, sensor.refusal_text),
    )


def _primesense(device: FoundDevice) -> Openable:
    return Openable(f"openni2:{device.uri}", f"{device.vendor} {device.name}", "", "", "")


def _unseen(sensor: UsbSensor, openni2: OpenNI2Devices) -> Openable:
    trouble = openni2.trouble or "libOpenNI2 does not see it"
    return Openable("openni2", sensor.model, sensor.where, sensor.serial, trouble)


def _unsupported(sensor: UsbSensor) -> Openable:
    return Openable("", sensor.model, sensor.where, "", "not supported")

"""The connected sensors, with the --camera value of each."""

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.camera import is_serial
from drivers.core import UserFacingError
from drivers.openni2.device import DetectedDevice, list_devices
from vo_service.tools.doctor.check import KINECT_MODELS, PRIMESENSE_MODELS
from vo_service.tools.doctor.stream_probe import call_in_subprocess
from vo_service.tools.doctor.usb_probe import OpenError, UsbSensor

OPENNI2_TIMEOUT_S = 15.0
_OPEN_ERROR_TEXTS = {
    OpenError.NONE: "",
    OpenError.PERMISSION: "this user may not open it",
    OpenError.BUSY: "another program has it",
    OpenError.GONE: "it has just been unplugged",
}


@dataclass(frozen=True)
class ListedDevice:
    """One connected sensor; the fields are those of --json, and stable.

    Attributes:
        camera: Value for --camera; "" if the sensor is not supported.
        name: Vendor and model.
        where: USB bus and port; "" if not known.
        serial: Serial number; "" if not known.
        error: Why it cannot be opened now; "" if no reason is known.
    """

    camera: str
    name: str
    where: str
    serial: str
    error: str


def list_available_devices(
    sensors: Sequence[UsbSensor], openni2: "OpenNI2Listing"
) -> list[ListedDevice]:
    """List all connected sensors. PrimeSense sensors have the names that OpenNI2 gives them."""
    kinects = [sensor for sensor in sensors if sensor.model in KINECT_MODELS]
    unsupported = [sensor for sensor in sensors if not sensor.is_supported]
    primesense = [sensor for sensor in sensors if sensor.model in PRIMESENSE_MODELS]
    no_driver = openni2.error or "libOpenNI2 does not see it"
    return [
        *(_list_kinect(sensor) for sensor in kinects),
        *(
            ListedDevice(f"openni2:{device.uri}", f"{device.vendor} {device.name}", "", "", "")
            for device in openni2.devices
        ),
        *(
            ListedDevice("openni2", sensor.model, sensor.where, sensor.serial, no_driver)
            for sensor in primesense[len(openni2.devices) :]
        ),
        *(
            ListedDevice("", sensor.model, sensor.where, "", "not supported")
            for sensor in unsupported
        ),
    ]


@dataclass(frozen=True)
class OpenNI2Listing:
    """Devices that libOpenNI2 finds, or the reason why it does not work."""

    devices: Sequence[DetectedDevice] = ()
    error: str = ""


def query_openni2() -> OpenNI2Listing:
    """List OpenNI2's devices in a subprocess."""
    try:
        return OpenNI2Listing(call_in_subprocess(list_devices, OPENNI2_TIMEOUT_S))
    except UserFacingError as error:
        return OpenNI2Listing((), str(error))


def _list_kinect(sensor: UsbSensor) -> ListedDevice:
    has_serial = is_serial(sensor.serial)
    return ListedDevice(
        camera=f"freenect:{sensor.serial}" if has_serial else "freenect",
        name=sensor.model,
        where=sensor.where,
        serial=sensor.serial if has_serial else "",
        error=_OPEN_ERROR_TEXTS.get(sensor.open_error, sensor.open_error_text),
    )

"""Which sensor is meant, among those that are plugged in."""

from drivers.errors import CameraError, CameraNotFoundError
from drivers.openni2.device import Device, FoundDevice, found_devices
from drivers.openni2.library import OpenNI2, OpenNI2Error


def list_devices() -> list[FoundDevice]:
    """The PrimeSense, Xtion and other sensors that libOpenNI2 has drivers for.

    Raises UserFacingError if libOpenNI2 is not installed, CameraError if it does not start.
    """
    return found_devices(OpenNI2())


def open_device(openni2: OpenNI2, wanted: str) -> Device:
    """The first sensor, or the one whose URI or serial number is `wanted`.

    Raises CameraNotFoundError if it is not there, CameraError if it is there but cannot be opened.
    """
    found = found_devices(openni2)
    for device in found:
        if wanted in ("", device.uri):
            return _opened(openni2, device)
    for device in found:
        if opened := _with_serial(openni2, device, wanted):
            return opened
    return _unlisted(openni2, wanted, found)


def _opened(openni2: OpenNI2, found: FoundDevice) -> Device:
    try:
        return Device(openni2, found.uri)
    except OpenNI2Error as error:
        raise CameraError(
            f"{found.vendor} {found.name} ({error}): it is plugged in, but another program uses it "
            "or this user may not; kinect-vo doctor tells which"
        ) from error


def _with_serial(openni2: OpenNI2, found: FoundDevice, serial: str) -> Device | None:
    try:
        device = Device(openni2, found.uri)
    except OpenNI2Error:
        return None
    if device.serial == serial:
        return device
    device.close()
    return None


def _unlisted(openni2: OpenNI2, wanted: str, found: list[FoundDevice]) -> Device:
    """Some drivers list a device only once it has been asked for by name."""
    try:
        return Device(openni2, wanted)
    except OpenNI2Error as error:
        there = ", ".join(device.uri for device in found)
        if not wanted:
            raise CameraNotFoundError(
                "no PrimeSense or Xtion sensor is plugged in (a Kinect is --camera freenect)"
            ) from error
        raise CameraNotFoundError(
            f"openni2:{wanted}: no sensor has this URI or serial number; "
            + (f"plugged in: {there}" if found else "none is plugged in")
        ) from error

"""Which sensor is meant, among those that are plugged in."""

from drivers.core.errors import CameraError, CameraNotFoundError
from drivers.openni2.device import DetectedDevice, OpenNI2Device, detect_devices
from drivers.openni2.library import OpenNI2, OpenNI2Error


def list_devices() -> list[DetectedDevice]:
    """The PrimeSense, Xtion and other sensors that libOpenNI2 has drivers for.

    Raises UserFacingError if libOpenNI2 is not installed, CameraError if it does not start.
    """
    return detect_devices(OpenNI2())


def open_device(openni2: OpenNI2, device_id: str) -> OpenNI2Device:
    """The first sensor, or the one whose URI or serial number is `wanted`.

    Raises CameraNotFoundError if it is not there, CameraError if it is there but cannot be opened.
    """
    found = detect_devices(openni2)
    for device in found:
        if device_id in ("", device.uri):
            return _open_detected(openni2, device)
    for device in found:
        if opened := _open_if_serial(openni2, device, device_id):
            return opened
    return _open_unlisted(openni2, device_id, found)


def _open_detected(openni2: OpenNI2, found: DetectedDevice) -> OpenNI2Device:
    try:
        return OpenNI2Device(openni2, found.uri)
    except OpenNI2Error as error:
        raise CameraError(
            f"{found.vendor} {found.name} ({error}): it is plugged in, but another program uses it "
            "or this user may not; kinect-vo doctor tells which"
        ) from error


def _open_if_serial(openni2: OpenNI2, found: DetectedDevice, serial: str) -> OpenNI2Device | None:
    try:
        device = OpenNI2Device(openni2, found.uri)
    except OpenNI2Error:
        return None
    if device.serial == serial:
        return device
    device.close()
    return None


def _open_unlisted(openni2: OpenNI2, device_id: str, found: list[DetectedDevice]) -> OpenNI2Device:
    """Some drivers list a device only once it has been asked for by name."""
    try:
        return OpenNI2Device(openni2, device_id)
    except OpenNI2Error as error:
        there = ", ".join(device.uri for device in found)
        if not device_id:
            raise CameraNotFoundError(
                "no PrimeSense or Xtion sensor is plugged in (a Kinect is --camera freenect)"
            ) from error
        raise CameraNotFoundError(
            f"openni2:{device_id}: no sensor has this URI or serial number; "
            + (f"plugged in: {there}" if found else "none is plugged in")
        ) from error

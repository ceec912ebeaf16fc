"""Selection of a sensor among the connected ones."""

from drivers.core.errors import CameraError, CameraNotFoundError
from drivers.openni2.device import DetectedDevice, OpenNI2Device, detect_devices
from drivers.openni2.library import OpenNI2, OpenNI2Error


def list_devices() -> list[DetectedDevice]:
    """List the PrimeSense, Xtion and other sensors that libOpenNI2 has drivers for.

    Raises:
        UserFacingError: libOpenNI2 is not installed.
        CameraError: libOpenNI2 does not start.
    """
    return detect_devices(OpenNI2())


def open_device(openni2: OpenNI2, device_id: str) -> OpenNI2Device:
    """Open the sensor with this URI or serial number, or the first one for "".

    Raises:
        CameraNotFoundError: The sensor is not connected.
        CameraError: The sensor is connected but cannot be opened.
    """
    detected_devices = detect_devices(openni2)
    for detected in detected_devices:
        if device_id in ("", detected.uri):
            return _open_detected(openni2, detected)
    for detected in detected_devices:
        if device := _open_if_serial(openni2, detected, device_id):
            return device
    return _open_unlisted(openni2, device_id, detected_devices)


def _open_detected(openni2: OpenNI2, detected: DetectedDevice) -> OpenNI2Device:
    try:
        return OpenNI2Device(openni2, detected.uri)
    except OpenNI2Error as error:
        raise CameraError(
            f"{detected.vendor} {detected.name} ({error}): it is plugged in, but another program "
            "uses it or this user may not open it; kinect-vo doctor shows which"
        ) from error


def _open_if_serial(
    openni2: OpenNI2, detected: DetectedDevice, serial: str
) -> OpenNI2Device | None:
    try:
        device = OpenNI2Device(openni2, detected.uri)
    except OpenNI2Error:
        return None
    if device.serial == serial:
        return device
    device.close()
    return None


def _open_unlisted(
    openni2: OpenNI2, device_id: str, detected_devices: list[DetectedDevice]
) -> OpenNI2Device:
    """Open a device by its URI: some drivers list a device only after that."""
    try:
        return OpenNI2Device(openni2, device_id)
    except OpenNI2Error as error:
        uris = ", ".join(detected.uri for detected in detected_devices)
        if not device_id:
            raise CameraNotFoundError(
                "no PrimeSense or Xtion sensor is plugged in (a Kinect is --camera freenect)"
            ) from error
        raise CameraNotFoundError(
            f"openni2:{device_id}: no sensor has this URI or serial number; "
            + (f"plugged in: {uris}" if uris else "none is plugged in")
        ) from error

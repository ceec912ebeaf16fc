"""Translation of pyusb's errors into messages for users."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager

import usb.core

from drivers.core.errors import CameraError, CameraLostError, UserFacingError


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

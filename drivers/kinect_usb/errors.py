"""What went wrong on the USB, said for a person."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager

import usb.core

from drivers.errors import CameraError, CameraLostError, UserFacingError


@contextmanager
def usb_errors_of(what: str) -> Iterator[None]:
    """Turn pyusb's errors into a CameraError about `what`; CameraLostError if it is unplugged.

    Raises UserFacingError if libusb is not installed.
    """
    try:
        yield
    except usb.core.NoBackendError as error:
        raise UserFacingError(
            "libusb-1.0.so.0 is not installed, without which no Kinect is found; "
            "apt install libusb-1.0-0"
        ) from error
    except (usb.core.USBError, NotImplementedError) as error:
        raise _camera_error(what, error) from error


def _camera_error(what: str, error: Exception) -> CameraError:
    number = getattr(error, "errno", None)
    if number in (errno.ENODEV, errno.ENOENT):
        return CameraLostError(f"{what}: unplugged; plug it in again")
    if number in (errno.EACCES, errno.EPERM):
        return CameraError(f"{what}: no permission; kinect-vo doctor says how to get it")
    if number == errno.EBUSY:
        return CameraError(f"{what}: in use by another program; close that first")
    if isinstance(error, usb.core.USBTimeoutError):
        return CameraError(f"{what}: does not answer; unplug it and plug it in again")
    return CameraError(f"{what}: {error}; unplug it and plug it in again")

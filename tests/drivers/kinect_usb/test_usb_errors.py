"""What pyusb raises, said for a person in one line."""

import errno

import pytest
import usb.core

from drivers.core import CameraError, CameraLostError, UserFacingError
from drivers.kinect_usb.usb_devices import translate_usb_errors


def raised(error: Exception) -> UserFacingError:
    with pytest.raises(UserFacingError) as caught, translate_usb_errors("Kinect 1414 motor"):
        raise error
    return caught.value


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (errno.EACCES, "no permission; kinect-vo doctor shows how to get it"),
        (errno.EBUSY, "in use by another program; close that first"),
        (errno.EIO, "[Errno 5] Input/Output Error; unplug it and plug it in again"),
    ],
)
def test_each_fault_has_a_text_and_a_remedy(number: int, text: str) -> None:
    error = raised(usb.core.USBError("Input/Output Error", errno=number))
    assert isinstance(error, CameraError)
    assert str(error) == f"Kinect 1414 motor: {text}"


def test_a_device_that_is_gone_is_lost() -> None:
    assert isinstance(raised(usb.core.USBError("gone", errno=errno.ENODEV)), CameraLostError)


def test_a_timeout_is_not_a_reply() -> None:
    error = raised(usb.core.USBTimeoutError("Operation timed out", errno=errno.ETIMEDOUT))
    assert "does not answer" in str(error)


def test_a_missing_library_is_reported_with_its_package() -> None:
    error = raised(usb.core.NoBackendError("No backend available"))
    assert not isinstance(error, CameraError)  # waiting does not mend it
    assert str(error).endswith("apt install libusb-1.0-0")


def test_other_errors_are_raised_unchanged() -> None:
    with pytest.raises(ZeroDivisionError), translate_usb_errors("it"):
        _ = 1 / 0

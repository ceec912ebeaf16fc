"""What can go wrong with a Kinect, as messages to the user."""

from drivers.core import CameraError, CameraLostError, CameraNotFoundError
from drivers.freenect.log import LibfreenectLog

OWN_CONTROLLER_ADVICE = "give the Kinect a USB 2 controller of its own"
NO_BANDWIDTH_LINE = "Failed to submit isochronous transfer 0"
DEVICE_BUSY_LINES = ("Failed to claim camera interface", "Failed to detach camera kernel driver")


def device_not_found_error(serial: str, present_serials: list[str]) -> CameraNotFoundError:
    """The Kinect is not on the bus; `serial` "" means any."""
    if serial and present_serials:
        return CameraNotFoundError(
            f"no Kinect with the serial number {serial} is on the USB; connected: "
            f"{', '.join(present_serials)}"
        )
    name = f"no Kinect {serial}" if serial else "no Kinect"
    return CameraNotFoundError(f"{name} on the USB; plug it in, and its own power supply too")


def no_permission_error() -> CameraError:
    """A Kinect is connected, but this user may not open it."""
    return CameraError(
        "a Kinect is plugged in, but this user may not open it; run: sudo kinect-vo udev install, "
        "then unplug it and plug it in again (replug after installing the rule)"
    )


def open_failed_error(log: LibfreenectLog) -> CameraError:
    """The Kinect was found but could not be opened."""
    # Not the last line: libfreenect logs further errors that follow from this one.
    busy_line = next(filter(None, map(log.find, DEVICE_BUSY_LINES)), "")
    if busy_line:
        return CameraError(
            f"the Kinect is held by another program or the kernel ({busy_line}); stop the "
            "program that uses it, and for the kernel's webcam driver run: sudo kinect-vo udev "
            "install, then sudo modprobe -r gspca_kinect"
        )
    return CameraError(
        f"libfreenect cannot open the Kinect ({log.last_line}); unplug it and plug it in again"
    )


def start_failed_error(step: str, log: LibfreenectLog) -> CameraError:
    """The Kinect is open, but a stream does not start."""
    return CameraError(
        f"libfreenect cannot {step} ({log.last_line}); unplug the Kinect and plug it in again"
    )


def no_bandwidth_error(log: LibfreenectLog) -> CameraError:
    """The USB bus has not enough bandwidth for the streams."""
    return CameraError(
        f"no USB bandwidth for the Kinect ({log.last_line}); {OWN_CONTROLLER_ADVICE} and no hub "
        "before it"
    )


def device_hung_error() -> CameraError:
    """A call of libfreenect does not return."""
    return CameraError(
        "libfreenect hangs: the Kinect does not answer; unplug it and start this program again"
    )


def unplugged_error() -> CameraLostError:
    """The device has disappeared."""
    return CameraLostError(
        "the Kinect is gone: unplugged, or without its own power supply; plug it in again"
    )


def stream_not_started_error(stream: str, timeout_s: float) -> CameraLostError:
    """A stream was started but never sent an image."""
    return CameraLostError(
        f"the Kinect sent no {stream} image within {timeout_s:g} s of its start: no USB bandwidth "
        f"or no 12 V supply; {OWN_CONTROLLER_ADVICE} and check its power supply"
    )


def stream_stalled_error(stream: str, timeout_s: float) -> CameraLostError:
    """A stream has stopped."""
    return CameraLostError(
        f"the Kinect sent no {stream} image for {timeout_s:g} s; it is opened again (if this comes "
        "back: check its power supply and cable)"
    )


def packet_loss_message(incomplete: int, images: int) -> str:
    """Describe a stream in which most images are incomplete."""
    return (
        f"losing USB packets: {incomplete} of {images} images incomplete; {OWN_CONTROLLER_ADVICE}"
    )

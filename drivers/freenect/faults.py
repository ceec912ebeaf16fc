"""What went wrong, in words that say what to do: read off libfreenect's log."""

from drivers.errors import CameraError, CameraLostError, CameraNotFoundError
from drivers.freenect.log import Log

OWN_CONTROLLER = "give the Kinect a USB 2 controller of its own"
NO_BANDWIDTH = "Failed to submit isochronous transfer 0"
BUSY = ("Failed to claim camera interface", "Failed to detach camera kernel driver")


def not_found(serial: str, others: list[str]) -> CameraNotFoundError:
    """The Kinect is not on the bus; `serial` "" means any."""
    if serial and others:
        return CameraNotFoundError(
            f"no Kinect with the serial number {serial} on the USB; there is {', '.join(others)}"
        )
    wanted = f"no Kinect {serial}" if serial else "no Kinect"
    return CameraNotFoundError(f"{wanted} on the USB; plug it in, and its own power supply too")


def no_permission() -> CameraError:
    """It is there, and this user may not open it."""
    return CameraError(
        "a Kinect is plugged in, but this user may not open it; run: sudo kinect-vo udev install, "
        "then unplug it and plug it in again (replug after installing the rule)"
    )


def cannot_open(log: Log) -> CameraError:
    """It was found and could not be opened."""
    # Not the last words: libfreenect goes on complaining of what follows from it.
    held = next(filter(None, map(log.find, BUSY)), "")
    if held:
        return CameraError(
            f"the Kinect is held by another program or the kernel ({held}); stop the "
            "program that uses it, and for the kernel's webcam driver run: sudo kinect-vo udev "
            "install, then sudo modprobe -r gspca_kinect"
        )
    return CameraError(
        f"libfreenect cannot open the Kinect ({log.last_words}); unplug it and plug it in again"
    )


def cannot_start(step: str, log: Log) -> CameraError:
    """It is open, and a stream does not start."""
    return CameraError(
        f"libfreenect cannot {step} ({log.last_words}); unplug the Kinect and plug it in again"
    )


def no_bandwidth(log: Log) -> CameraError:
    """The system has no room for the streams on this bus."""
    return CameraError(
        f"no USB bandwidth for the Kinect ({log.last_words}); {OWN_CONTROLLER} and no hub before it"
    )


def hangs() -> CameraError:
    """A call of libfreenect does not come back."""
    return CameraError(
        "libfreenect hangs: the Kinect does not answer; unplug it and start this program again"
    )


def unplugged() -> CameraLostError:
    """The device was given up."""
    return CameraLostError(
        "the Kinect is gone: unplugged, or without its own power supply; plug it in again"
    )


def never_began(stream: str, limit_s: float) -> CameraLostError:
    """A stream that was started never sent an image."""
    return CameraLostError(
        f"the Kinect sent no {stream} image within {limit_s:g} s of its start: no USB bandwidth "
        f"or no 12 V supply; {OWN_CONTROLLER} and check its power supply"
    )


def stalled(stream: str, limit_s: float) -> CameraLostError:
    """A stream stopped."""
    return CameraLostError(
        f"the Kinect sent no {stream} image for {limit_s:g} s; it is opened again (if this comes "
        "back: check its power supply and cable)"
    )


def losing(torn: int, images: int) -> str:
    """Images come, most of them with holes."""
    return f"losing USB packets: {torn} of {images} frames torn; {OWN_CONTROLLER}"

"""The parts of libfreenect's C interface that are used, through ctypes; its log and its errors.

A process can use one library: once fakenect is loaded, the SONAME finds fakenect too.
"""

import ctypes
import logging
import re
import time
from collections import deque
from ctypes import (
    CFUNCTYPE,
    POINTER,
    Structure,
    c_char_p,
    c_double,
    c_float,
    c_int,
    c_int8,
    c_int16,
    c_int32,
    c_long,
    c_uint16,
    c_uint32,
    c_void_p,
)
from enum import IntEnum
from typing import Any

from drivers.core import CameraError, CameraLostError, CameraNotFoundError, UserFacingError

SONAME = "libfreenect.so.0.5"
PACKAGE = "libfreenect0.5"

CAMERA_ONLY = 1 << 1
LOG_SPEW = 6
INTERRUPTED = -10  # from libusb: a signal arrived; not an error


class DepthFormat(IntEnum):
    """The unit and the view of a depth image."""

    RAW_11_BIT = 0
    REGISTERED_MM = 4  # as seen by the color camera
    MM = 5  # as seen by the depth camera


class Flag(IntEnum):
    """Flags of the color camera. Mirroring is done in software, see `KinectRectifier`."""

    AUTO_WHITE_BALANCE = 1 << 1
    AUTO_EXPOSURE = 1 << 14


RAW_VALUES = 2048
RESOLUTION_640X480 = 1
# Units of the registration's columns; its rows are whole pixels.
REGISTRATION_UNITS_PER_PX = 256
VIDEO_RGB = 0


class FrameMode(Structure):
    """freenect_frame_mode; passed by value."""

    _fields_ = (
        ("reserved", c_uint32),
        ("resolution", c_int32),
        ("format", c_int32),
        ("bytes", c_int32),
        ("width", c_int16),
        ("height", c_int16),
        ("data_bits", c_int8),
        ("padding_bits", c_int8),
        ("framerate", c_int8),
        ("is_valid", c_int8),
    )


class DeviceAttributes(Structure):
    """freenect_device_attributes, a linked list."""


DeviceAttributes._fields_ = (("next", POINTER(DeviceAttributes)), ("camera_serial", c_char_p))


class Registration(Structure):
    """freenect_registration; returned by value, the caller frees its tables."""

    _fields_ = (
        ("registration_polynomials", c_int32 * 29),
        ("padding", c_uint16 * 3),
        ("emitter_distance_cm", c_float),
        ("color_distance_cm", c_float),
        ("reference_distance_mm", c_float),
        ("reference_pixel_mm", c_float),
        ("const_shift", c_double),
        ("raw_to_mm", POINTER(c_uint16)),
        ("depth_to_rgb_shift", POINTER(c_int32)),
        ("registration_table", POINTER(c_int32)),
    )


class TimeValue(Structure):
    """struct timeval."""

    _fields_ = (("seconds", c_long), ("microseconds", c_long))


FRAME_CALLBACK = CFUNCTYPE(None, c_void_p, c_void_p, c_uint32)
LOG_CALLBACK = CFUNCTYPE(None, c_void_p, c_int, c_char_p)

_CONTEXT = _DEVICE = c_void_p
_PROTOTYPES: dict[str, tuple[Any, list[Any]]] = {
    "init": (c_int, [POINTER(_CONTEXT), c_void_p]),
    "shutdown": (c_int, [_CONTEXT]),
    "set_log_level": (None, [_CONTEXT, c_int]),
    "set_log_callback": (None, [_CONTEXT, LOG_CALLBACK]),
    "select_subdevices": (None, [_CONTEXT, c_int]),
    "num_devices": (c_int, [_CONTEXT]),
    "list_device_attributes": (c_int, [_CONTEXT, POINTER(POINTER(DeviceAttributes))]),
    "free_device_attributes": (None, [POINTER(DeviceAttributes)]),
    "open_device_by_camera_serial": (c_int, [_CONTEXT, POINTER(_DEVICE), c_char_p]),
    "close_device": (c_int, [_DEVICE]),
    "process_events_timeout": (c_int, [_CONTEXT, POINTER(TimeValue)]),
    "find_depth_mode": (FrameMode, [c_int, c_int]),
    "find_video_mode": (FrameMode, [c_int, c_int]),
    "set_depth_mode": (c_int, [_DEVICE, FrameMode]),
    "set_video_mode": (c_int, [_DEVICE, FrameMode]),
    "set_depth_callback": (None, [_DEVICE, FRAME_CALLBACK]),
    "set_video_callback": (None, [_DEVICE, FRAME_CALLBACK]),
    "start_depth": (c_int, [_DEVICE]),
    "start_video": (c_int, [_DEVICE]),
    "stop_depth": (c_int, [_DEVICE]),
    "stop_video": (c_int, [_DEVICE]),
    "set_flag": (c_int, [_DEVICE, c_int, c_int]),
    "copy_registration": (Registration, [_DEVICE]),
    "destroy_registration": (c_int, [POINTER(Registration)]),
}


def load_library(path: str = SONAME) -> ctypes.CDLL:
    """Load libfreenect by its SONAME or path.

    Functions that fakenect lacks are missing in the result too (check with `hasattr`).

    Raises:
        UserFacingError: The library is not installed.
    """
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        raise UserFacingError(
            f"{path} is not installed or cannot be loaded ({error}): apt install {PACKAGE}"
        ) from error
    for name, (result, arguments) in _PROTOTYPES.items():
        function = getattr(library, f"freenect_{name}", None)
        if function is not None:
            function.restype, function.argtypes = result, arguments
    return library


WARNING_LEVEL = 2
HEALTH_WINDOW_S = 1.0
_log = logging.getLogger("libfreenect")
_STREAM_LINE = re.compile(r"\[Stream (70|80)\] (.*)")
_LOST_PACKETS = re.compile(r"Lost (\d+) packets")
_SHORT_PACKET = re.compile(r"Expected \d+ data bytes")
_IMAGE_DONE = re.compile(r"Got (depth|video) frame of size \d+/\d+, (\d+)/(\d+) packets")


class StreamHealth:
    """The counters of one stream. libfreenect's thread writes them; others may read.

    Attributes:
        images: Images that the device sent, incomplete ones included.
        incomplete: Images with missing packets. libfreenect delivers them with old pixels in the
            gaps, or discards them.
        lost_packets: Packets that never arrived.
        last_activity_s: CLOCK_MONOTONIC of the last image or warning; 0 before the first. A stream
            with warnings is alive.
    """

    def __init__(self) -> None:
        self.images = self.incomplete = self.lost_packets = 0
        self.last_activity_s = 0.0
        self._is_incomplete = False
        self._recent: deque[tuple[float, bool]] = deque(maxlen=100)

    def add_warning(self, text: str) -> None:
        """Parse a warning about this stream's packets."""
        self.last_activity_s = time.monotonic()
        if lost := _LOST_PACKETS.match(text):
            self.lost_packets += int(lost[1])
        elif "esync" in text:  # "resyncing": the rest of the image is discarded
            self._add_image(is_incomplete=True)
        elif _SHORT_PACKET.match(text):
            self._is_incomplete = True

    def check_packet_count(self, packets: int, expected: int) -> None:
        """Check the packets of the image that is delivered next."""
        self._is_incomplete |= packets < expected

    def add_delivered(self, now_s: float) -> bool:
        """Count a delivered image; return whether it is complete."""
        self.last_activity_s = now_s
        is_incomplete, self._is_incomplete = self._is_incomplete, False
        self._add_image(is_incomplete)
        return not is_incomplete

    def count_recent(self, now_s: float) -> tuple[int, int]:
        """Return the numbers of incomplete images and of all images in the last second."""
        since_s = now_s - HEALTH_WINDOW_S
        recent = [is_incomplete for s, is_incomplete in self._recent.copy() if s >= since_s]
        return sum(recent), len(recent)

    def _add_image(self, is_incomplete: bool) -> None:
        self.images += 1
        self.incomplete += is_incomplete
        self._recent.append((self.last_activity_s, is_incomplete))


class LibfreenectLog:
    """Parses libfreenect's log at its level SPEW, which has one line for each image."""

    def __init__(self) -> None:
        self.color, self.depth = StreamHealth(), StreamHealth()
        self._warnings: deque[str] = deque(maxlen=50)

    def add_line(self, level: int, text: str) -> None:
        """Parse one line of libfreenect's log callback."""
        if match := _IMAGE_DONE.match(text):
            stream = self.depth if match[1] == "depth" else self.color
            stream.check_packet_count(int(match[2]), int(match[3]))
        elif match := _STREAM_LINE.match(text):
            if _is_warning(match[2]):
                _log.debug("%s", text.strip())
                (self.depth if match[1] == "70" else self.color).add_warning(match[2])
        else:
            _log.debug("%s", text.strip())
            if level <= WARNING_LEVEL:
                self._warnings.append(text.strip())

    def contains(self, text: str) -> bool:
        """Whether a warning or error contains this text."""
        return bool(self.find(text))

    def find(self, text: str) -> str:
        """Return the first warning or error that contains this text; "" if there is none."""
        return next((line for line in self._warnings if text in line), "")

    @property
    def last_line(self) -> str:
        """The last warning or error, for an error message."""
        return self._warnings[-1] if self._warnings else "libfreenect gives no reason"


def _is_warning(text: str) -> bool:
    """Whether a stream's line is a warning: not its packet size, nor that it is not synced yet."""
    return not text.startswith(("Negotiated", "Not synced"))


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

"""The parts of libfreenect's C interface that are used, through ctypes.

A process can use one library: once fakenect is loaded, the SONAME finds fakenect too.
"""

import ctypes
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
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from drivers.core import UserFacingError

SONAME = "libfreenect.so.0.5"
PACKAGE = "libfreenect0.5"

CAMERA_ONLY = 1 << 1
LOG_SPEW = 6
INTERRUPTED = -10  # from libusb: a signal arrived; not an error


@dataclass(frozen=True)
class StreamFormat:
    """A format of a stream's images at 640x480.

    Attributes:
        number: Its number in libfreenect.
        shape: Shape of the array of an image.
        dtype: Type of its values.
    """

    number: int
    shape: tuple[int, ...]
    dtype: DTypeLike


COLOR_RGB = StreamFormat(0, (480, 640, 3), np.uint8)
COLOR_BAYER = StreamFormat(1, (480, 640), np.uint8)  # as the Kinect sends it
DEPTH_11_BIT = StreamFormat(0, (480, 640), np.uint16)
DEPTH_11_BIT_PACKED = StreamFormat(2, (480 * 640 * 11 // 8,), np.uint8)  # as the Kinect sends it


class Flag(IntEnum):
    """Flags of the color camera. Mirroring is done in software, see `KinectRectifier`."""

    AUTO_WHITE_BALANCE = 1 << 1
    AUTO_EXPOSURE = 1 << 14


RESOLUTION_640X480 = 1


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

"""libOpenNI2 through ctypes: its structures, constants and functions.

Call it from one thread only, which must live as long as the process, such as the main thread. The
library records every thread that ever called it. At the first call of another thread it checks
whether those still exist, and crashes if one has ended. So this package starts no threads.
"""

import ctypes
import weakref
from enum import IntEnum
from functools import partial
from typing import Any

from drivers.core import CameraError, UserFacingError

SONAME = "libOpenNI2.so.0"
API_VERSION = 2002
MAX_TEXT_BYTES = 256


class SensorType(IntEnum):
    """The sensor of a stream."""

    COLOR = 2
    DEPTH = 3


class PixelFormat(IntEnum):
    """The storage format of a pixel."""

    DEPTH_1_MM = 100
    DEPTH_100_UM = 101
    RGB888 = 200
    YUV422 = 201  # U Y V Y
    GRAY8 = 202
    YUYV = 205


class DeviceProperty(IntEnum):
    """Properties of a device or a recording."""

    SERIAL = 3
    IMAGE_REGISTRATION = 5
    PLAYBACK_SPEED = 100
    PLAYBACK_REPEAT = 101


class StreamProperty(IntEnum):
    """Properties of a stream."""

    CROPPING = 0
    HORIZONTAL_FOV = 1
    VERTICAL_FOV = 2
    VIDEO_MODE = 3
    MIRRORING = 7
    AUTO_WHITE_BALANCE = 100
    AUTO_EXPOSURE = 101


REGISTRATION_OFF, REGISTRATION_DEPTH_TO_COLOR = 0, 1
TIMED_OUT = 102


class VideoMode(ctypes.Structure):
    """Format, size in pixels and images per second."""

    _fields_ = (
        ("format", ctypes.c_int),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("fps", ctypes.c_int),
    )


class SensorInfo(ctypes.Structure):
    """The video modes of a sensor."""

    _fields_ = (
        ("sensor", ctypes.c_int),
        ("mode_count", ctypes.c_int),
        ("modes", ctypes.POINTER(VideoMode)),
    )


class DeviceInfo(ctypes.Structure):
    """A connected device or an open recording."""

    _fields_ = (
        ("uri", ctypes.c_char * MAX_TEXT_BYTES),
        ("vendor", ctypes.c_char * MAX_TEXT_BYTES),
        ("name", ctypes.c_char * MAX_TEXT_BYTES),
        ("usb_vendor", ctypes.c_uint16),
        ("usb_product", ctypes.c_uint16),
    )


class OniFrame(ctypes.Structure):
    """An image in the library's memory, until it is released; `stamp_us` is the device's clock."""

    _fields_ = (
        ("size", ctypes.c_int),
        ("data", ctypes.c_void_p),
        ("sensor", ctypes.c_int),
        ("stamp_us", ctypes.c_uint64),
        ("index", ctypes.c_int),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
        ("mode", VideoMode),
        ("is_cropped", ctypes.c_int),
        ("crop_x", ctypes.c_int),
        ("crop_y", ctypes.c_int),
        ("stride", ctypes.c_int),
    )


class Cropping(ctypes.Structure):
    """The delivered part of the image."""

    _fields_ = (
        ("is_on", ctypes.c_int),
        ("x", ctypes.c_int),
        ("y", ctypes.c_int),
        ("width", ctypes.c_int),
        ("height", ctypes.c_int),
    )


DEVICE_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.POINTER(DeviceInfo), ctypes.c_void_p)
STATE_CALLBACK = ctypes.CFUNCTYPE(None, ctypes.POINTER(DeviceInfo), ctypes.c_int, ctypes.c_void_p)


class DeviceCallbacks(ctypes.Structure):
    """Callbacks on the library's threads; null for none."""

    _fields_ = (
        ("connected", DEVICE_CALLBACK),
        ("disconnected", DEVICE_CALLBACK),
        ("state_changed", STATE_CALLBACK),
    )


class OpenNI2Error(CameraError):
    """A call failed; the text is the library's own, in one line."""


def load_library() -> ctypes.CDLL:
    """Load libOpenNI2. Raises UserFacingError."""
    try:
        library = ctypes.CDLL(SONAME)
    except OSError as error:
        raise UserFacingError(
            f"{SONAME} cannot be loaded: {error}; apt install libopenni2-0"
        ) from error
    _declare_functions(library)
    return library


class OpenNI2:
    """The initialized libOpenNI2. Its drivers detect sensors until the object is deleted.

    Keep it while a camera is closed and opened again: each start leaks 140 kB.

    Raises:
        UserFacingError: libOpenNI2 is not installed.
        OpenNI2Error: libOpenNI2 does not start.
    """

    def __init__(self) -> None:
        self.library = load_library()
        check_status(self.library, self.library.oniInitialize(API_VERSION), "OpenNI2 cannot start")
        weakref.finalize(self, self.library.oniShutdown)


def check_status(library: ctypes.CDLL, status: int, what: str) -> None:
    """Raise OpenNI2Error unless `status` means success."""
    if status == 0:
        return
    details = library.oniGetExtendedError().decode(errors="replace")
    raise OpenNI2Error("; ".join([what, *filter(None, map(str.strip, details.splitlines()))]))


def read_property(get: Any, handle: ctypes.c_void_p, prop: int, value: Any) -> bool:
    """Read a property into `value` with a function of the library; False if it does not exist."""
    size = ctypes.c_int(ctypes.sizeof(value))
    status: int = get(handle, prop, ctypes.byref(value), ctypes.byref(size))
    return status == 0


def _declare_functions(library: ctypes.CDLL) -> None:
    """Declare argument and result types; without them a handle would be truncated to an int."""
    handle, number = ctypes.c_void_p, ctypes.c_int
    pointer, size = ctypes.c_void_p, ctypes.POINTER(ctypes.c_int)
    declare = partial(_declare_function, library)
    declare("oniInitialize", number, number)
    declare("oniShutdown", None)
    declare("oniGetExtendedError", ctypes.c_char_p)
    declare("oniGetDeviceList", number, pointer, size)
    declare("oniReleaseDeviceList", number, pointer)
    declare("oniRegisterDeviceCallbacks", number, pointer, handle, pointer)
    declare("oniUnregisterDeviceCallbacks", None, handle)
    declare("oniDeviceOpen", number, ctypes.c_char_p, pointer)
    declare("oniDeviceClose", number, handle)
    declare("oniDeviceGetInfo", number, handle, pointer)
    declare("oniDeviceGetSensorInfo", ctypes.POINTER(SensorInfo), handle, number)
    declare("oniDeviceGetProperty", number, handle, number, pointer, size)
    declare("oniDeviceSetProperty", number, handle, number, pointer, number)
    declare("oniDeviceIsImageRegistrationModeSupported", number, handle, number)
    declare("oniDeviceEnableDepthColorSync", number, handle)
    declare("oniDeviceGetDepthColorSyncEnabled", number, handle)
    declare("oniDeviceCreateStream", number, handle, number, pointer)
    declare("oniStreamDestroy", None, handle)
    declare("oniStreamStart", number, handle)
    declare("oniStreamStop", None, handle)
    declare("oniStreamReadFrame", number, handle, pointer)
    declare("oniStreamGetProperty", number, handle, number, pointer, size)
    declare("oniStreamSetProperty", number, handle, number, pointer, number)
    declare("oniStreamIsPropertySupported", number, handle, number)
    declare("oniWaitForAnyStream", number, pointer, number, size, number)
    declare("oniFrameRelease", None, pointer)


def _declare_function(library: ctypes.CDLL, name: str, result: Any, *arguments: Any) -> None:
    function = getattr(library, name)
    function.restype, function.argtypes = result, arguments

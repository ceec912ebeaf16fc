"""What libfreenect reads from: the interface, and a Kinect on the USB."""

import ctypes
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Clock, SensorConfig
from drivers.core.flow_control import BoundedQueue, DropOldestQueue
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.factory_calibration import (
    DepthFilter,
    FactoryCalibration,
    ValidDepthMask,
    find_valid_depths_mm,
)
from drivers.freenect.image_buffers import ImagePair
from drivers.freenect.libfreenect_log import (
    NO_BANDWIDTH_LINE,
    LibfreenectLog,
    device_not_found_error,
    no_bandwidth_error,
    no_permission_error,
    open_failed_error,
    unplugged_error,
)
from drivers.freenect.library import SONAME, DepthFormat, Flag, load_library
from drivers.time_sync import MIN_IMAGE_PERIOD_S, HostClockSync


@dataclass(frozen=True)
class StreamTimeouts:
    """Time limits for the first and for the next image of each stream."""

    first_image_s: float
    next_image_s: float


@dataclass(frozen=True)
class DeviceCalibration:
    """What a device says about itself; a dump has no factory calibration."""

    depth_filter: DepthFilter
    factory: FactoryCalibration | None = None


class StampConverter(Protocol):
    """Converts a stream's device stamps to the camera's clock."""

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        """Convert a frame's device stamp; call it for frames in order."""
        ...


class DeviceSource(Protocol):
    """The differences between a real device and a dump.

    Attributes:
        min_period_s: The shortest period between color images.
    """

    name: str
    clock: Clock
    timeouts: StreamTimeouts
    min_period_s: float

    def load(self) -> ctypes.CDLL:
        """Load the library. Raises UserFacingError without it, InputError for an invalid dump."""
        ...

    def open(self, context: FreenectContext) -> AbstractContextManager[FreenectDevice]:
        """Find the device and open it. Raises CameraNotFoundError, CameraError."""
        ...

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """Return the depth format to set in the library."""
        ...

    def configure(self, device: FreenectDevice) -> DeviceCalibration:
        """Apply the settings and read the calibration while both streams run."""
        ...

    def make_end_exception(self) -> Exception:
        """Make the exception for the end of libfreenect's events."""
        ...

    def make_queue(self) -> BoundedQueue[ImagePair]:
        """Make the queue that passes image pairs to the reader."""
        ...

    def make_stamp_converter(self) -> StampConverter:
        """Make the converter for the color stream, which starts with the first image."""
        ...


# The shortest time from a stamp until the host has the whole color image: 162 packets, one every
# 125 us. It is assumed that the stamp marks the first packet.
COLOR_READOUT_S = 162 * 125e-6


class KinectSource:
    """A Kinect 1414, 1473 or Kinect for Windows, by serial number ("" for the first one found)."""

    clock = Clock.MONOTONIC
    timeouts = StreamTimeouts(first_image_s=2.0, next_image_s=1.0)
    min_period_s = MIN_IMAGE_PERIOD_S

    def __init__(self, serial: str, settings: SensorConfig, library: str = SONAME) -> None:
        self.name = f"freenect:{serial}" if serial else "freenect"
        self._serial, self._settings, self._library = serial, settings, library

    def load(self) -> ctypes.CDLL:
        return load_library(self._library)

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        with context.open_device(find_serial(context, self._serial)) as device:
            if device is None:
                raise open_failed_error(context.log)
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        return wanted

    def configure(self, device: FreenectDevice) -> DeviceCalibration:
        """Set exposure and white balance, and read the calibration of the factory.

        Raises:
            CameraError: The bus has not enough bandwidth for the streams.
        """
        if device.log.contains(NO_BANDWIDTH_LINE):
            raise no_bandwidth_error(device.log)
        device.set_flag(Flag.AUTO_EXPOSURE, self._settings.auto_exposure)
        device.set_flag(Flag.AUTO_WHITE_BALANCE, self._settings.auto_white_balance)
        raw_to_mm, factory = device.read_factory_calibration()
        return DeviceCalibration(ValidDepthMask(find_valid_depths_mm(raw_to_mm)), factory)

    def make_end_exception(self) -> Exception:
        return unplugged_error()

    def make_queue(self) -> BoundedQueue[ImagePair]:
        """Make a queue that keeps the newest pair."""
        return DropOldestQueue(1)

    def make_stamp_converter(self) -> HostClockSync:
        return HostClockSync(COLOR_READOUT_S)


def find_serial(context: FreenectContext, serial: str) -> str:
    """Return the serial number of the Kinect to open. Raises CameraNotFoundError, CameraError."""
    serials = context.list_serials()
    if not serials and context.device_count() > 0:
        raise no_permission_error()
    if not serials or serial not in {"", *serials}:
        raise device_not_found_error(serial, serials)
    return serial or serials[0]


def list_kinects(library: str = SONAME) -> list[str]:
    """Return the serial numbers of the Kinects that can be opened.

    Raises:
        UserFacingError: libfreenect is not installed.
        CameraError: There are Kinects, but this user may open none of them.
    """
    with closing(FreenectContext(load_library(library), LibfreenectLog())) as context:
        serials = context.list_serials()
        if not serials and context.device_count() > 0:
            raise no_permission_error()
        return serials

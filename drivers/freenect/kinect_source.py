"""The Kinect on the USB."""

import ctypes
from collections.abc import Iterator
from contextlib import closing, contextmanager

from drivers.camera import Clock
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.error_messages import (
    NO_BANDWIDTH_LINE,
    device_not_found_error,
    no_bandwidth_error,
    no_permission_error,
    open_failed_error,
    unplugged_error,
)
from drivers.freenect.frame_queue import FrameQueue, LatestFrameQueue
from drivers.freenect.libfreenect_log import LibfreenectLog
from drivers.freenect.library import SONAME, DepthFormat, Flag, load_library
from drivers.freenect.valid_depth import DepthFilter, ValidDepthMask, find_valid_depths_mm
from drivers.freenect.watchdog import StreamTimeouts
from drivers.sensor_config import SensorConfig
from drivers.time_sync import MIN_IMAGE_PERIOD_S, HostClockSync

# From the instant that a stamp marks until the host has the whole color image, at the soonest:
# 162 packets, one every 125 us. That the stamp marks the first packet is not known, but assumed.
COLOR_READOUT_S = 162 * 125e-6


class KinectSource:
    """Models 1414, 1473 and Kinect for Windows, by serial number; "" for the first one found."""

    clock = Clock.MONOTONIC
    timeouts = StreamTimeouts(first_image_s=2.0, next_image_s=1.0)
    min_period_s = MIN_IMAGE_PERIOD_S

    def __init__(self, serial: str, settings: SensorConfig, library: str = SONAME) -> None:
        self.name = f"freenect:{serial}" if serial else "freenect"
        self._serial, self._settings, self._library = serial, settings, library

    def load(self) -> ctypes.CDLL:
        """See `Source`."""
        return load_library(self._library)

    @contextmanager
    def open(self, context: FreenectContext) -> Iterator[FreenectDevice]:
        """See `Source`."""
        with context.open_device(find_serial(context, self._serial)) as device:
            if device is None:
                raise open_failed_error(context.log)
            yield device

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """See `Source`."""
        return wanted

    def configure(self, device: FreenectDevice) -> DepthFilter:
        """See `Source`. Raises CameraError if the bus has no room for the streams."""
        if device.log.contains(NO_BANDWIDTH_LINE):
            raise no_bandwidth_error(device.log)
        device.set_flag(Flag.AUTO_EXPOSURE, self._settings.auto_exposure)
        device.set_flag(Flag.AUTO_WHITE_BALANCE, self._settings.auto_white_balance)
        return ValidDepthMask(find_valid_depths_mm(device.read_raw_to_mm()))

    def make_end_exception(self) -> Exception:
        """See `Source`."""
        return unplugged_error()

    def make_queue(self) -> FrameQueue:
        """See `Source`: live, the newest pair counts."""
        return LatestFrameQueue()

    def make_stamp_converter(self) -> HostClockSync:
        """See `Source`."""
        return HostClockSync(COLOR_READOUT_S)


def find_serial(context: FreenectContext, serial: str) -> str:
    """The serial number of the Kinect to open. Raises CameraNotFoundError, CameraError."""
    serials = context.list_serials()
    if not serials and context.device_count() > 0:
        raise no_permission_error()
    if not serials or serial not in {"", *serials}:
        raise device_not_found_error(serial, serials)
    return serial or serials[0]


def list_kinects(library: str = SONAME) -> list[str]:
    """Serial numbers of the Kinects that can be opened.

    Raises UserFacingError without libfreenect, CameraError if there are some but this user may
    open none of them.
    """
    with closing(FreenectContext(load_library(library), LibfreenectLog())) as context:
        serials = context.list_serials()
        if not serials and context.device_count() > 0:
            raise no_permission_error()
        return serials

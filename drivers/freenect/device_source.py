"""The interface to what libfreenect reads from: a Kinect, or a dump that fakenect plays."""

import ctypes
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Clock
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.factory_calibration import DepthFilter, FactoryCalibration
from drivers.freenect.frame_queue import FrameQueue
from drivers.freenect.library import DepthFormat
from drivers.freenect.watchdog import StreamTimeouts


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

    def make_queue(self) -> FrameQueue:
        """Make the queue that passes image pairs to the reader."""
        ...

    def make_stamp_converter(self) -> StampConverter:
        """Make the converter for the color stream, which starts with the first image."""
        ...

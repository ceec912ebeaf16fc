"""What is behind libfreenect: a Kinect, or a dump that fakenect plays."""

import ctypes
from contextlib import AbstractContextManager
from typing import Protocol

from drivers.camera import Clock
from drivers.freenect.context import FreenectContext, FreenectDevice
from drivers.freenect.frame_queue import FrameQueue
from drivers.freenect.library import DepthFormat
from drivers.freenect.valid_depth import DepthFilter
from drivers.freenect.watchdog import StreamTimeouts


class StampConverter(Protocol):
    """Puts a stream's device seconds on the camera's clock."""

    def to_host_s(self, device_s: float, receive_time_s: float) -> float:
        """The instant of `device_s`, of a frame that was whole at `receive_time_s`; frames in order."""
        ...


class DeviceSource(Protocol):
    """Where the real device and the dump differ.

    shortest_period_s  color images are never closer together
    """

    name: str
    clock: Clock
    timeouts: StreamTimeouts
    min_period_s: float

    def load(self) -> ctypes.CDLL:
        """The library. Raises UserFacingError without it, InputError for a dump of no use."""
        ...

    def open(self, context: FreenectContext) -> AbstractContextManager[FreenectDevice]:
        """Find the device and open it. Raises CameraNotFoundError, CameraError."""
        ...

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """What to ask the library for."""
        ...

    def configure(self, device: FreenectDevice) -> DepthFilter:
        """Apply the settings, now that both streams run; tells which depths are readings."""
        ...

    def make_end_exception(self) -> Exception:
        """Why libfreenect has no more events."""
        ...

    def make_queue(self) -> FrameQueue:
        """How pairs are passed on."""
        ...

    def make_stamp_converter(self) -> StampConverter:
        """For the color stream, from its first image on."""
        ...

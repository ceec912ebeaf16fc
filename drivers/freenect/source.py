"""What is behind libfreenect: a Kinect, or a dump that fakenect plays."""

import ctypes
from contextlib import AbstractContextManager
from typing import Protocol

from drivers.camera import Clock
from drivers.freenect.context import Context, Device
from drivers.freenect.depth import DepthFilter
from drivers.freenect.library import DepthFormat
from drivers.freenect.mailbox import Mailbox
from drivers.freenect.watchdog import Patience


class StampMap(Protocol):
    """Puts a stream's device seconds on the camera's clock."""

    def host_s(self, device_s: float, arrival_s: float) -> float:
        """The instant of `device_s`, of a frame that was whole at `arrival_s`; frames in order."""
        ...


class Source(Protocol):
    """Where the real device and the dump differ.

    shortest_period_s  colour images are never closer together
    """

    name: str
    clock: Clock
    patience: Patience
    shortest_period_s: float

    def load(self) -> ctypes.CDLL:
        """The library. Raises UserFacingError without it, InputError for a dump of no use."""
        ...

    def open(self, context: Context) -> AbstractContextManager[Device]:
        """Find the device and open it. Raises CameraNotFoundError, CameraError."""
        ...

    def depth_format(self, wanted: DepthFormat) -> DepthFormat:
        """What to ask the library for."""
        ...

    def set_up(self, device: Device) -> DepthFilter:
        """Apply the settings, now that both streams run; tells which depths are readings."""
        ...

    def end(self) -> Exception:
        """Why libfreenect has no more events."""
        ...

    def mailbox(self) -> Mailbox:
        """How pairs are passed on."""
        ...

    def stamp_map(self) -> StampMap:
        """For the colour stream, from its first image on."""
        ...

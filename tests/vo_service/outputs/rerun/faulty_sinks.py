"""Places for pictures that fail in one way or another, in the viewer's process."""

import threading
from typing import TYPE_CHECKING

from vo_service.outputs.rerun.sinks import DiskFullError, LiveSink

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb


class _InMemorySink(LiveSink):
    """Takes everything in."""

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Keep it."""
        self._kept = stream.memory_recording()


class BlockingSink(_InMemorySink):
    """A viewer that takes no data: Rerun blocks, for ever."""

    address = "stuck"

    def check(self, stream: "rr.RecordingStream") -> None:
        """Wait."""
        threading.Event().wait()


class LeakingSink(_InMemorySink):
    """Data that nobody takes: each picture leaves some megabytes more."""

    address = "glutton"

    def __init__(self, mb: int) -> None:
        self._mb = mb
        self._more: list[bytes] = []

    def check(self, stream: "rr.RecordingStream") -> None:
        """Grow, and write to all of it."""
        self._more.append(b"x" * (self._mb * 1_000_000))


class FullDiskSink(_InMemorySink):
    """A disk that fills up with the first picture."""

    address = "full"

    def check(self, stream: "rr.RecordingStream") -> None:
        """It is full."""
        raise DiskFullError("full: the disk is full")

"""Where Rerun's pictures can go: what such a place offers, and the viewer that is running."""

import re
import time
from threading import Thread
from typing import TYPE_CHECKING, Any, Protocol

from drivers.camera import PlaybackMode
from drivers.core.errors import InputError, UserFacingError
from drivers.core.queues import BoundedQueue, DropOldestQueue
from vo_service.outputs.rerun.viewer_probe import AlwaysPresent, GrpcViewerProbe, ViewerProbe

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "kinect-vo"
LOOPBACK = "127.0.0.1"
DATA_PORT = 9876  # Rerun's own default
CONNECT_TIMEOUT_S = 0.5


class Sink(Protocol):
    """One place for pictures. It goes to the viewer's process as it was made, and opens there.

    address    what a person opens
    is_kept    whether what arrives is meant to last
    batch_s    how long Rerun may gather what is logged before it passes it on
    """

    address: str
    is_persistent: bool
    flush_interval_s: float

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """What results wait in: full, it drops the oldest, or makes a replay wait."""

    def rate_clock_s(self, stamp_s: float) -> float:
        """The time, of a frame with this stamp, that the rate of pictures is measured on."""

    def make_probe(self) -> ViewerProbe:
        """What tells whether anything can be shown there."""

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Make the stream go here. Raises UserFacingError, DiskFullError too."""

    def check(self, stream: "rr.RecordingStream") -> None:
        """See that what was logged has arrived. Raises DiskFullError, BrokenFileError."""

    def is_full(self) -> bool:
        """Whether the stream should end and another be attached."""

    def close(self) -> None:
        """Release what is not the stream's. Must not block."""


class DiskFullError(UserFacingError):
    """Nothing is kept until there is space; what is there can be ended in order."""


class BrokenFileError(UserFacingError):
    """The file cannot be written. Its stream must be left alone: Rerun may wait on it for ever."""


class PortTakenError(UserFacingError):
    """A port of this computer cannot be listened on."""

    def __init__(self, port: int, reason: object) -> None:
        super().__init__(port, reason)
        self._port, self._reason = port, reason

    def __str__(self) -> str:
        return (
            f"rerun cannot listen on {LOOPBACK}:{self._port}: {self._reason}; stop what uses the "
            "port, or record to a file that ends in .rrd instead"
        )


class LiveSink:
    """What the places that are watched now have in common."""

    is_persistent = False
    flush_interval_s = 0.2

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """The newest counts."""
        return DropOldestQueue(2)

    def rate_clock_s(self, stamp_s: float) -> float:
        """The clock of this computer: a viewer has to keep up with real seconds."""
        return time.monotonic()

    def make_probe(self) -> ViewerProbe:
        """It is always there."""
        return AlwaysPresent()

    def check(self, stream: "rr.RecordingStream") -> None:
        """Nothing is kept."""

    def is_full(self) -> bool:
        """Old pictures make room for new ones."""
        return False

    def close(self) -> None:
        """Nothing to release."""


class RunningViewerSink(LiveSink):
    """A Rerun viewer that is running (``rerun``), such as rerun+http://127.0.0.1:9876/proxy.

    Raises InputError for an address that is none.
    """

    def __init__(self, address: str = f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy") -> None:
        self.address = address
        self._host, self._port = _host_and_port(address)

    def make_probe(self) -> ViewerProbe:
        """It may come, freeze and go."""
        return GrpcViewerProbe(self._host, self._port)

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Connect; a viewer that is not there gets nothing."""
        # Rerun waits five seconds for a viewer that is not there.
        connecting = Thread(
            target=stream.connect_grpc,
            args=(self.address,),
            kwargs={"default_blueprint": blueprint},
            daemon=True,
        )
        connecting.start()
        connecting.join(CONNECT_TIMEOUT_S)


def _host_and_port(address: str) -> tuple[str, int]:
    parts = re.fullmatch(r"rerun\+http://([\w.-]+|\[[0-9a-fA-F:]+\]):(\d{1,5})/proxy", address)
    if parts is None or not 0 < int(parts[2]) < 1 << 16:
        raise InputError(
            f"{address}: not the address of a Rerun viewer: write it as "
            f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy"
        )
    return parts[1].strip("[]"), int(parts[2])

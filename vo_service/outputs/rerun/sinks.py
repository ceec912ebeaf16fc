"""Sinks for Rerun's data: the protocol, live sinks, and a viewer that is already running."""

import re
import socket
import time
from typing import TYPE_CHECKING, Any, Protocol

from drivers.camera import PlaybackMode
from drivers.core.errors import InputError, UserFacingError
from drivers.core.queues import BoundedQueue, DropOldestQueue

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "kinect-vo"
LOOPBACK = "127.0.0.1"
DATA_PORT = 9876  # Rerun's own default
PRESENCE_TIMEOUT_S = 0.7
# A viewer that takes longer to read what was sent is frozen.
FLUSH_TIMEOUT_S = 5.0


class Sink(Protocol):
    """Destination of Rerun's data. It is sent to the viewer's process and opened there.

    Attributes:
        address: Address or file that the user opens.
        is_persistent: Whether the data is stored.
        flush_interval_s: How long Rerun may collect data before it sends it.
    """

    address: str
    is_persistent: bool
    flush_interval_s: float

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """Make the queue of results; when full, it drops the oldest or makes a replay wait."""

    def rate_clock_s(self, stamp_s: float) -> float:
        """Return the time, for a frame with this stamp, that limits the rate of images."""

    @property
    def absence_text(self) -> str:
        """What is wrong while the sink is not there."""

    def is_present(self) -> bool:
        """Return whether the sink is there; may take a second."""

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Send the stream to this sink. Raises UserFacingError, DiskFullError."""

    def check(self, stream: "rr.RecordingStream") -> None:
        """Check that the logged data has arrived.

        Raises:
            DiskFullError, BrokenFileError, ViewerGoneError: It has not.
        """

    def is_full(self) -> bool:
        """Return whether the stream should be closed and attached again."""

    def close(self) -> None:
        """Release everything but the stream. Must not block."""


class DiskFullError(UserFacingError):
    """The disk is full; the file so far is valid, and recording may continue later."""


class BrokenFileError(UserFacingError):
    """The file cannot be written. Its stream must not be closed: Rerun may block forever."""


class ViewerGoneError(UserFacingError):
    """The viewer has exited or is frozen. Its stream must not be closed: Rerun may block."""


class PortTakenError(UserFacingError):
    """A local port is in use."""

    def __init__(self, port: int, reason: object) -> None:
        super().__init__(port, reason)
        self._port, self._reason = port, reason

    def __str__(self) -> str:
        return (
            f"rerun cannot listen on {LOOPBACK}:{self._port}: {self._reason}; stop what uses the "
            "port, or record to a file that ends in .rrd instead"
        )


class LiveSink:
    """Common part of the sinks that show data live."""

    is_persistent = False
    flush_interval_s = 0.2

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """Make a short queue that drops the oldest result."""
        return DropOldestQueue(2)

    def rate_clock_s(self, stamp_s: float) -> float:
        """Return this computer's clock: a viewer draws in real time."""
        return time.monotonic()

    @property
    def absence_text(self) -> str:
        """Nothing: it is always there."""
        return ""

    def is_present(self) -> bool:
        """Return True: the sink is in this computer."""
        return True

    def check(self, stream: "rr.RecordingStream") -> None:
        """Do nothing: no data is stored."""

    def is_full(self) -> bool:
        """Return False: new data replaces old."""
        return False

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


class RunningViewerSink(LiveSink):
    """A Rerun viewer that is already running, such as at rerun+http://127.0.0.1:9876/proxy.

    Raises:
        InputError: The address is invalid.
    """

    def __init__(self, address: str = f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy") -> None:
        self.address = address
        self._host, self._port = _host_and_port(address)

    @property
    def absence_text(self) -> str:
        """How to start a viewer."""
        return f"no viewer answers at {self.address}; start one with: rerun"

    def is_present(self) -> bool:
        """Return whether a program listens there; only `check` knows whether it is a viewer."""
        try:
            socket.create_connection((self._host, self._port), PRESENCE_TIMEOUT_S).close()
        except (OSError, OverflowError, UnicodeError):
            return False
        return True

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Connect to the viewer. Raises ViewerGoneError."""
        stream.connect_grpc(self.address, default_blueprint=blueprint)  # at most five seconds
        self.check(stream)

    def check(self, stream: "rr.RecordingStream") -> None:
        """Check that the viewer reads. Raises ViewerGoneError."""
        try:
            stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            raise ViewerGoneError(self.absence_text) from error


def _host_and_port(address: str) -> tuple[str, int]:
    parts = re.fullmatch(r"rerun\+http://([\w.-]+|\[[0-9a-fA-F:]+\]):(\d{1,5})/proxy", address)
    if parts is None or not 0 < int(parts[2]) < 1 << 16:
        raise InputError(
            f"{address}: not the address of a Rerun viewer: write it as "
            f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy"
        )
    return parts[1].strip("[]"), int(parts[2])

"""Where Rerun's pictures can go: what such a place offers, the file and the viewer."""

import logging
import re
import socket
import time
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Protocol

from drivers.errors import InputError
from vo_service.outputs.output import PoseUpdate

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

logger = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"
DATA_PORT = 9876  # Rerun's own default
CONNECT_WAIT_S = 0.5


class Sink(Protocol):
    """One place for pictures.

    address    what a person opens
    queue      results that may wait for the worker before the oldest is dropped
    close_s    how long finishing may take
    """

    address: str
    queue: int
    close_s: float

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Make the stream go here. Raises InputError or UserFacingError."""

    def clock_s(self, update: PoseUpdate) -> float:
        """The time that the rate of pictures is measured on."""

    def close(self) -> None:
        """Release what is not the stream's. Must not block."""


class RecordingFile:
    """An .rrd file. Pictures follow the frames' own time, so that a fast replay has as many."""

    queue = 8
    close_s = 10.0

    def __init__(self, path: Path) -> None:
        self.address = str(path)

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Create the file."""
        try:
            stream.save(self.address, default_blueprint=blueprint)
        except (RuntimeError, UnicodeError) as error:
            raise InputError(
                f"{self.address}: cannot write the Rerun recording: {error}"
            ) from error

    def clock_s(self, update: PoseUpdate) -> float:
        """The frame's stamp."""
        return update.frame.stamp_s

    def close(self) -> None:
        """The stream closes the file."""


class LiveSink:
    """What the places that are watched now have in common."""

    queue = 2
    close_s = 2.5

    def clock_s(self, update: PoseUpdate) -> float:
        """The clock of this computer: a viewer has to keep up with real seconds."""
        return time.monotonic()


class Viewer(LiveSink):
    """A Rerun viewer that is running (``rerun``), such as rerun+http://127.0.0.1:9876/proxy.

    Raises InputError for an address that is none.
    """

    def __init__(self, address: str = f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy") -> None:
        self.address = address
        self._host, self._port = _host_and_port(address)

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Connect; a viewer that starts later gets what is logged from then on."""
        # Rerun waits five seconds for a viewer that is not there.
        connecting = Thread(target=self._connect, args=(stream, blueprint), daemon=True)
        connecting.start()
        if not self._answers():
            logger.warning("no Rerun viewer at %s yet; start one with: rerun", self.address)
        connecting.join(CONNECT_WAIT_S)

    def close(self) -> None:
        """The viewer stays open."""

    def _connect(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        try:
            stream.connect_grpc(self.address, default_blueprint=blueprint)
        except RuntimeError as error:
            logger.error("rerun: cannot connect to %s: %s", self.address, error)

    def _answers(self) -> bool:
        try:
            socket.create_connection((self._host, self._port), CONNECT_WAIT_S).close()
        except (OSError, OverflowError):
            return False
        return True


def _host_and_port(address: str) -> tuple[str, int]:
    parts = re.fullmatch(r"rerun\+http://([\w.-]+|\[[0-9a-fA-F:]+\]):(\d{1,5})/proxy", address)
    if parts is None or not 0 < int(parts[2]) < 1 << 16:
        raise InputError(
            f"{address}: not the address of a Rerun viewer: write it as "
            f"rerun+http://{LOOPBACK}:{DATA_PORT}/proxy"
        )
    return parts[1].strip("[]"), int(parts[2])

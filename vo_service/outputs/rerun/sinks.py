"""Sinks of the viewer: a viewer that runs, or .rrd files with limits of size and number."""

import re
import socket
import time
from abc import ABC, abstractmethod
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, Any

from drivers.camera import PlaybackMode
from drivers.core import InputError, UserFacingError
from drivers.core.files import MEGABYTE, rotate_file
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue
from drivers.core.write_errors import (
    check_disk_space,
    check_growth,
    creating,
    is_disk_full,
    writing,
)
from vo_service.outputs.loopback_ports import LOOPBACK

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

APPLICATION = "kinect-vo"
DATA_PORT = 9876  # Rerun's own default
PRESENCE_TIMEOUT_S = 0.7
# A viewer that takes longer to read what was sent is frozen, a disk that takes longer hangs.
FLUSH_TIMEOUT_S = 5.0
# After the first failed write Rerun writes nothing more, but its flush waits for the whole timeout.
FLUSH_STEP_S = 0.25


class Sink(ABC):
    """Destination of Rerun's data. It is sent to the viewer's process and opened there.

    Attributes:
        address: Address or file that the user opens.
        is_persistent: Whether the data is stored.
        flush_interval_s: How long Rerun may collect data before it sends it.
    """

    address: str
    is_persistent: bool
    flush_interval_s: float

    @abstractmethod
    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """Make the queue of results; when full, it drops the oldest or makes a replay wait."""

    @abstractmethod
    def rate_clock_s(self, stamp_s: float) -> float:
        """Return the time, for a frame with this stamp, that limits the rate of images."""

    @property
    def absence_text(self) -> str:
        """What is wrong while the sink is not there."""
        return ""

    def is_present(self) -> bool:
        """Return whether the sink is there; may take a second."""
        return True

    @abstractmethod
    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Send the stream to this sink. Raises UserFacingError."""

    @abstractmethod
    def check(self, stream: "rr.RecordingStream") -> None:
        """Check that the logged data has arrived.

        Raises:
            WriteError, BrokenFileError, ViewerGoneError: It has not.
        """

    @abstractmethod
    def is_full(self) -> bool:
        """Return whether the stream should be closed and attached again."""

    def close(self) -> None:  # noqa: B027 (few hold anything)
        """Release everything but the stream. Must not block."""


class BrokenFileError(UserFacingError):
    """The file cannot grow. Its stream must not be closed: Rerun may block forever."""


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


class LiveSink(Sink):
    """Common part of the sinks that show data live."""

    is_persistent = False
    flush_interval_s = 0.2

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """Make a short queue that drops the oldest result."""
        return DropOldestQueue(2)

    def rate_clock_s(self, stamp_s: float) -> float:
        """Return this computer's clock: a viewer draws in real time."""
        return time.monotonic()

    def check(self, stream: "rr.RecordingStream") -> None:
        """Do nothing: no data is stored."""

    def is_full(self) -> bool:
        """Return False: new data replaces old."""
        return False


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
            f"{address}: not the address of a Rerun viewer: write the target as "
            f"connect:HOST:PORT, such as connect:{LOOPBACK}:{DATA_PORT}"
        )
    return parts[1].strip("[]"), int(parts[2])


QUEUE_CAPACITY = 8
# Left free for the end of the file: without its index, Rerun opens a file slowly.
RESERVE_BYTES = 16 * MEGABYTE


class RrdFileSink(Sink):
    """Writes FILE.rrd; full files and files of earlier runs are renamed.

    They become FILE-0001.rrd, FILE-0002.rrd and so on; the highest number is the newest. The rate
    of images follows the frames' stamps, so a fast replay has as many.

    Args:
        path: FILE.rrd.
        file_mb: Greatest size of one file.
        files_kept: Greatest number of files, FILE.rrd included.
    """

    is_persistent = True
    # Rerun keeps 3 kB in memory for every batch of a file until its end.
    flush_interval_s = 2.0

    def __init__(self, path: Path, file_mb: int = 500, files_kept: int = 4) -> None:
        self.address = str(path)
        self._path = path
        self._max_file_bytes = file_mb * MEGABYTE
        self._files_kept = files_kept
        self._flushed_bytes = 0
        self._layout = b""

    def make_queue(self, playback_mode: PlaybackMode) -> BoundedQueue[Any]:
        """Make a queue; in lockstep, it makes the replay wait for the file."""
        return (
            BlockingQueue(QUEUE_CAPACITY)
            if playback_mode is PlaybackMode.LOCKSTEP
            else DropOldestQueue(QUEUE_CAPACITY)
        )

    def rate_clock_s(self, stamp_s: float) -> float:
        """Return the frame's stamp."""
        return stamp_s

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Create the file. Raises InputError or WriteError if that fails."""
        self._check_name()
        with creating(self._path):
            TemporaryFile(dir=self._path.parent).close()  # before any file is renamed
            check_disk_space(self._path.parent, 2 * RESERVE_BYTES)
            rotate_file(self._path, self._files_kept)
            try:
                stream.save(self.address)
                # Not as `default_blueprint`: Rerun never frees the memory of that, 1 MB per file.
                self._layout = self._layout or self._serialize_blueprint(blueprint)
                stream.log_file_from_contents("layout.rbl", self._layout)
            except RuntimeError as error:
                self._check_space()
                raise self._unwritable_error(str(error)) from error
        self._flushed_bytes = 0

    def check(self, stream: "rr.RecordingStream") -> None:
        """Flush the file. Raises WriteError if it is gone or space is low, or BrokenFileError."""
        with writing(self._path):
            self._flush(stream)
            self._flushed_bytes = self._path.stat().st_size
            # Only now: a stream with unwritten data may block forever when it is closed.
            check_disk_space(self._path.parent, RESERVE_BYTES)

    def is_full(self) -> bool:
        """Return whether the file has reached its greatest size; WriteError if it is gone."""
        with writing(self._path):
            return self._path.stat().st_size >= self._max_file_bytes

    def _flush(self, stream: "rr.RecordingStream") -> None:
        """Flush the file; stop waiting as soon as the disk is full. Raises BrokenFileError."""
        due_s = time.monotonic() + FLUSH_TIMEOUT_S
        while True:
            begin_s = time.monotonic()
            try:
                stream.flush(timeout_sec=FLUSH_STEP_S)
                return
            except RuntimeError as error:
                now_s = time.monotonic()
                has_timed_out = now_s - begin_s >= FLUSH_STEP_S
                is_full = self._is_disk_full()
                if has_timed_out and now_s < due_s and not is_full:
                    continue
                cause = "the disk is full" if is_full else f"the file cannot be written ({error})"
                raise self._broken_error(cause) from error

    def _is_disk_full(self) -> bool:
        try:
            self._check_space()
        except OSError as error:
            return is_disk_full(error)
        return False

    def _check_space(self) -> None:
        """Raise OSError if the file cannot grow: Rerun does not say why."""
        check_disk_space(self._path.parent, RESERVE_BYTES)
        check_growth(self._path)

    def _broken_error(self, cause: str) -> BrokenFileError:
        """Make the error, and end the file where it is complete."""
        # Rerun does not read a file that ends in the middle of a message.
        with suppress(OSError), self._path.open("r+b") as file:
            file.truncate(self._flushed_bytes)
            if not self._flushed_bytes:
                self._path.unlink()
        return BrokenFileError(
            f"{self.address}: the recording stops after {self._flushed_bytes} bytes: {cause}; fix "
            "this and start again"
        )

    def _serialize_blueprint(self, blueprint: "rrb.Blueprint") -> bytes:
        """Return the bytes of Rerun's .rbl file."""
        with TemporaryDirectory(dir=self._path.parent) as folder:
            file = Path(folder) / "layout.rbl"
            blueprint.save(APPLICATION, file)
            return file.read_bytes()

    def _check_name(self) -> None:
        """Raise InputError unless a file can have this name."""
        try:
            self.address.encode()  # Rerun needs valid Unicode
        except UnicodeError as error:
            raise self._unwritable_error(str(error)) from error
        if self._path.exists() and not self._path.is_file():
            kind = "a folder" if self._path.is_dir() else "not a regular file"
            raise self._unwritable_error(f"it is {kind}")

    def _unwritable_error(self, cause: str) -> InputError:
        return InputError(
            f"{self.address}: cannot write the Rerun recording: {cause}; name another file"
        )

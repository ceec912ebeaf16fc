"""Sink that writes .rrd files of bounded size and number."""

from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, Any

from drivers.camera import PlaybackMode
from drivers.core.errors import InputError
from drivers.core.files import free_disk_bytes, is_disk_full, rotate_file
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue
from vo_service.config_tables import MEGABYTE
from vo_service.outputs.rerun.sinks import APPLICATION, BrokenFileError, DiskFullError

if TYPE_CHECKING:
    import rerun as rr
    import rerun.blueprint as rrb

QUEUE_CAPACITY = 8
FLUSH_TIMEOUT_S = 5.0
# Left free for the end of the file: without its index, Rerun opens a file slowly.
RESERVE_BYTES = 16 * MEGABYTE


class RrdFileSink:
    """Writes FILE.rrd; full files and files of earlier runs are renamed.

    They become FILE-0001.rrd, FILE-0002.rrd and so on; the highest number is the newest. The rate
    of images follows the frames' stamps, so a fast replay has as many.

    Args:
        path: FILE.rrd.
        file_mb: Greatest size of one file.
        files_kept: Greatest number of files, FILE.rrd included.
    """

    is_persistent = True
    absence_text = ""
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

    def is_present(self) -> bool:
        """Return True: `attach` creates the file."""
        return True

    def attach(self, stream: "rr.RecordingStream", blueprint: "rrb.Blueprint") -> None:
        """Create the file. Raises InputError if that fails, DiskFullError."""
        try:
            self._check_writable()
            self._check_disk_space(2 * RESERVE_BYTES)
            rotate_file(self._path, self._files_kept)
            stream.save(self.address)
            # Not as `default_blueprint`: Rerun never frees the memory of that, 1 MB per file.
            self._layout = self._layout or self._serialize_blueprint(blueprint)
            stream.log_file_from_contents("layout.rbl", self._layout)
        except (OSError, RuntimeError, UnicodeError) as error:
            raise self._unwritable_error(str(error)) from error
        self._flushed_bytes = 0

    def check(self, stream: "rr.RecordingStream") -> None:
        """Flush the file. Raises DiskFullError if space is low, BrokenFileError if that fails."""
        self._check_disk_space(RESERVE_BYTES)
        try:
            stream.flush(timeout_sec=FLUSH_TIMEOUT_S)
        except RuntimeError as error:
            # Rerun does not read a file that ends in the middle of a message.
            with self._path.open("r+b") as file:
                file.truncate(self._flushed_bytes)
            raise BrokenFileError(
                f"{self.address}: the recording stops after {self._flushed_bytes} bytes: the file "
                f"cannot be written ({error}); fix this and start again"
            ) from error
        self._flushed_bytes = self._path.stat().st_size

    def is_full(self) -> bool:
        """Return whether the file has reached its greatest size."""
        return self._path.stat().st_size >= self._max_file_bytes

    def close(self) -> None:
        """Do nothing: the stream closes the file."""

    def _serialize_blueprint(self, blueprint: "rrb.Blueprint") -> bytes:
        """Return the bytes of Rerun's .rbl file."""
        with TemporaryDirectory(dir=self._path.parent) as folder:
            file = Path(folder) / "layout.rbl"
            blueprint.save(APPLICATION, file)
            return file.read_bytes()

    def _check_writable(self) -> None:
        """Check before any file is renamed. Raises InputError with the cause, DiskFullError."""
        folder = self._path.parent
        self.address.encode()  # Rerun needs valid Unicode
        if self._path.exists() and not self._path.is_file():
            kind = "a folder" if self._path.is_dir() else "not a regular file"
            raise self._unwritable_error(f"it is {kind}")
        if not folder.is_dir():
            raise self._unwritable_error(f"the folder {folder} does not exist")
        try:
            TemporaryFile(dir=folder).close()
        except OSError as error:
            if is_disk_full(error):
                raise self._disk_full_error() from error
            raise self._unwritable_error(
                f"cannot create a file in {folder}: {error.strerror}"
            ) from error

    def _check_disk_space(self, needed_bytes: int) -> None:
        if free_disk_bytes(self._path.parent) < needed_bytes:
            raise self._disk_full_error()

    def _unwritable_error(self, cause: str) -> InputError:
        return InputError(
            f"{self.address}: cannot write the Rerun recording: {cause}; name another file"
        )

    def _disk_full_error(self) -> DiskFullError:
        return DiskFullError(
            f"{self.address}: the disk is full; recording continues when space is free again"
        )

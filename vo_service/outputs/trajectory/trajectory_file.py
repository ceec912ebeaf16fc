"""Outputs that keep the trajectory: in a text file of the TUM RGB-D benchmark, or in memory."""

import errno
import logging
import math
import os
from contextlib import suppress
from io import FileIO
from pathlib import Path

import numpy as np

from drivers.camera import PlaybackMode
from drivers.core.errors import InputError
from drivers.core.files import atomic_write
from drivers.core.geometry import Array, Trajectory, format_pose_line
from drivers.core.queues import BlockingQueue, BoundedQueue, DropOldestQueue
from drivers.core.write_errors import WriteError, check_in_place, creating, writing
from vo_service.outputs.file_output import FileOutput
from vo_service.types.messages import Status
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import OutputBase

logger = logging.getLogger(__name__)

# Time limit, at the end, for a disk that hangs.
CLOSE_TIMEOUT_S = 2.0
# Limit of lines in the queue of a slow disk: five minutes.
MAX_QUEUED_LINES = 9000


def _open_without_waiting(path: Path) -> FileIO:
    """Create or empty a file; a pipe that nothing reads would wait for its reader."""

    def open_nonblocking(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NONBLOCK, 0o666)

    try:
        file = FileIO(path, "wb", opener=open_nonblocking)
    except OSError as error:
        if error.errno != errno.ENXIO:
            raise
        raise InputError(f"{path}: nothing reads this pipe; start its reader first") from error
    os.set_blocking(file.fileno(), True)
    return file


def open_trajectory(path: str, playback_mode: PlaybackMode) -> "TrajectoryFileOutput":
    """Open a trajectory file, whose queue blocks in lockstep.

    Raises:
        InputError: No file can have this name.
        WriteError: It cannot be written.
    """
    is_lockstep = playback_mode is PlaybackMode.LOCKSTEP
    lines: BoundedQueue[bytes] = (
        BlockingQueue(64) if is_lockstep else DropOldestQueue(MAX_QUEUED_LINES)
    )
    return TrajectoryFileOutput(Path(path), lines)


class TrajectoryFileOutput(FileOutput[bytes]):
    """Writes ``stamp tx ty tz qx qy qz qw`` of the optical camera, one line per tracked frame.

    Stamps are the published ones. A separate thread appends line by line, so every finished line
    survives a crash. A frame without its own pose has no line. If the clock was set back, the lines
    are sorted by their stamps at the end; of equal stamps the last line is kept. After a failed
    write (disk full) the file ends with its last whole line, one without a line is removed, and
    `close` raises the error.
    """

    def __init__(self, path: Path, line_queue: BoundedQueue[bytes]) -> None:
        """Create or empty the file.

        Args:
            line_queue: Queue of the lines; it blocks or drops if the disk is slow.

        Raises:
            InputError: No file can have this name.
            WriteError: It cannot be written.
        """
        super().__init__(path, "trajectory", "poses", CLOSE_TIMEOUT_S)
        self._size = 0
        self._last_stamp_s, self._is_rising = -math.inf, True
        with creating(path):
            self._file = _open_without_waiting(path)
        self._start("trajectory", line_queue)

    def on_update(self, update: OdometryUpdate) -> None:
        """Queue one line if this frame has its own pose."""
        if update.estimate.ok and not self._fault:
            self._is_rising &= update.stamp_s > self._last_stamp_s
            self._last_stamp_s = update.stamp_s
            self._worker.put(format_pose_line(update.stamp_s, update.T_world_camera).encode())

    def on_status(self, status: Status) -> None:
        """Do nothing: the file holds poses only."""

    def _write(self, item: bytes) -> None:
        if self._fault:
            return
        try:
            check_in_place(self._file.fileno(), self._path)
            written = self._file.write(item)
            if written != len(item):
                raise OSError(errno.ENOSPC, "no space left for a whole line")
            self._size += len(item)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file.fileno(), self._size)
            remark = f"the trajectory stops after {self._size} bytes"
            self._fail(WriteError.of(self._path, error, remark))
            if not self._size:
                self._remove()

    def _remove(self) -> None:
        """Remove the file, unless it is a device or another one has its name by now."""
        with suppress(OSError):
            check_in_place(self._file.fileno(), self._path)
            if self._path.is_file():
                self._path.unlink()

    def _finish(self) -> None:
        self._file.close()
        if self._is_rising or not self._path.is_file():
            return
        try:
            with writing(self._path, "the lines are not sorted by their stamps"):
                lines = self._path.read_bytes().splitlines(keepends=True)
                line_of = {float(line.split()[0]): line for line in lines}
                atomic_write(self._path, b"".join(line for _, line in sorted(line_of.items())))
        except WriteError as error:
            self._fail(error)

    def _fail(self, error: WriteError) -> None:
        self._fault.set(error, can_retry=False)
        logger.error("%s", error)


class TrajectoryRecorder(OutputBase):
    """Stores the pose of every tracked frame with the camera's stamp.

    Attributes:
        publish_offset_s: Published stamp minus the frame's stamp, s.
    """

    def __init__(self) -> None:
        self._stamps_s: list[float] = []
        self._poses: list[Array] = []
        self.publish_offset_s = 0.0

    def on_update(self, update: OdometryUpdate) -> None:
        """Store one pose if this frame has its own."""
        if update.estimate.ok:
            self._stamps_s.append(update.frame.stamp_s)
            self._poses.append(update.T_world_camera)
            self.publish_offset_s = update.stamp_s - update.frame.stamp_s

    @property
    def trajectory(self) -> Trajectory:
        """All poses so far, sorted by stamp; of poses with the same stamp, the last."""
        stamps_s = np.array(self._stamps_s)
        poses = np.array(self._poses).reshape(-1, 4, 4)
        _, last = np.unique(stamps_s[::-1], return_index=True)
        selected = len(stamps_s) - 1 - last
        return Trajectory(stamps_s[selected], poses[selected])

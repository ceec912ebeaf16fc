"""The trajectory as a text file in the TUM RGB-D benchmark's format."""

import logging
import os
from contextlib import suppress
from pathlib import Path

from drivers.errors import InputError, UserFacingError
from drivers.trajectory import pose_line
from vo_service.outputs.output import PoseUpdate, Status

logger = logging.getLogger(__name__)


class TrajectoryOutput:
    """Writes ``stamp tx ty tz qx qy qz qw`` of the optical camera, one line a good frame.

    The file is created (or emptied) at once and grows line by line, so that whatever ends the
    process, every finished line is kept. A frame without a pose of its own writes no line. After
    a failed write (disk full) nothing more is written, the file ends with its last whole line,
    and `close` raises the error.

    Raises InputError if the file cannot be created.
    """

    warning = ""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._size = 0
        self._failure: UserFacingError | None = None
        try:
            self._file = path.open("wb", buffering=0)
        except OSError as error:
            raise InputError(
                f"{path}: cannot write the trajectory: {error.strerror}; name a file in a folder "
                "that you may write to"
            ) from error

    def pose(self, update: PoseUpdate) -> None:
        """Write one line, if this frame has a pose of its own."""
        if update.estimate.ok and self._failure is None:
            line = pose_line(update.frame.stamp_s, update.T_world_camera).encode()
            self._append(line)

    def status(self, status: Status) -> None:
        """Nothing to write."""

    def close(self) -> None:
        """Close the file. Raises UserFacingError, once, if a line could not be written."""
        self._file.close()
        failure, self._failure = self._failure, None
        if failure is not None:
            raise UserFacingError(f"{self._path}: the trajectory is not complete") from failure

    def _append(self, line: bytes) -> None:
        try:
            written = self._file.write(line)
            if written != len(line):
                raise OSError(0, "no space left for a whole line")
            self._size += len(line)
        except OSError as error:
            with suppress(OSError):
                os.ftruncate(self._file.fileno(), self._size)
            self._failure = UserFacingError(
                f"{self._path}: the trajectory stops after {self._size} bytes: {error.strerror}; "
                "free some space and run again"
            )
            logger.error("%s", self._failure)

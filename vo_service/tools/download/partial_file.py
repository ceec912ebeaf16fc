"""The beginning of a file that is on its way, kept so that the rest can follow at any time."""

import fcntl
import json
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Self

from drivers.core.errors import UserFacingError
from drivers.core.files import atomic_write, free_disk_bytes, is_disk_full


def disk_error(folder: Path, error: OSError) -> UserFacingError:
    """What a failure to write below `folder` means for a person."""
    if is_disk_full(error):
        return UserFacingError(
            f"{folder}: the disk is full; free some space and give the same command again: "
            "what has come is kept"
        )
    return UserFacingError(
        f"{folder}: cannot be written: {error.strerror}; name another folder with --output"
    )


class PartialFile:
    """A locked file that only grows, and beside it a note of what it is the beginning of.

    The origin is a pair: the address, and the server's mark for this very version of the file.
    """

    def __init__(self, path: Path) -> None:
        """Open or create it. Raises UserFacingError if it cannot be, or another process has it."""
        self.path = path
        self._metadata_path = path.with_name(f"{path.name}.json")
        try:
            self._file = path.open("ab", buffering=0)
        except OSError as error:
            raise disk_error(path.parent, error) from error
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            self._file.close()
            raise UserFacingError(
                f"{path}: another kinect-vo is downloading it; wait for it to end"
            ) from error

    @property
    def size(self) -> int:
        """Bytes that are there."""
        return os.fstat(self._file.fileno()).st_size

    def validator(self, url: str) -> str:
        """The version of `url` that this is the beginning of; empty if it is of none."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            note = json.loads(self._metadata_path.read_text())
            if note["url"] == url and self.size:
                return str(note["mark"])
        return ""

    def restart(self, url: str, validator: str) -> None:
        """Start again from nothing. Raises UserFacingError."""
        try:
            self._file.truncate(0)
            atomic_write(self._metadata_path, json.dumps({"url": url, "mark": validator}).encode())
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def append(self, data: bytes) -> None:
        """Add to its end. Raises UserFacingError; as much as there was room for is then there."""
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def require_free_space(self, size: int) -> None:
        """Raise UserFacingError unless the disk has room for so many bytes more."""
        free = free_disk_bytes(self.path.parent)
        if free < size:
            raise UserFacingError(
                f"{self.path.parent}: {size / 1e9:.2f} GB are needed and {free / 1e9:.2f} GB are "
                "free; free some space or name another folder with --output"
            )

    def discard(self) -> None:
        """Remove it, and the note."""
        self.path.unlink(missing_ok=True)
        self._metadata_path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        exc_type: type[BaseException] | None,
        exc: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if self.size == 0:
            self.discard()
        self._file.close()

"""Partial download of a file, which can be resumed at any time."""

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
    """Return a user-facing error for a failure to write below `folder`."""
    if is_disk_full(error):
        return UserFacingError(
            f"{folder}: the disk is full; free some space and run the same command again; "
            "the partial download is kept"
        )
    return UserFacingError(
        f"{folder}: cannot be written: {error.strerror}; name another folder with --output"
    )


class PartialFile:
    """Locked file that only grows, with a metadata file beside it.

    The metadata are the address and the server's validator of this version of the file.
    """

    def __init__(self, path: Path) -> None:
        """Open or create the file. Raises UserFacingError on failure or if it is locked."""
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
        """Size, bytes."""
        return os.fstat(self._file.fileno()).st_size

    def validator(self, url: str) -> str:
        """Return the validator of the partial download of `url`; empty if it is not from there."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            metadata = json.loads(self._metadata_path.read_text())
            if metadata["url"] == url and self.size:
                return str(metadata["mark"])
        return ""

    def restart(self, url: str, validator: str) -> None:
        """Truncate the file and store new metadata.

        Raises:
            UserFacingError: If that fails.
        """
        try:
            self._file.truncate(0)
            atomic_write(self._metadata_path, json.dumps({"url": url, "mark": validator}).encode())
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def append(self, data: bytes) -> None:
        """Append data.

        Raises:
            UserFacingError: After writing as much as possible.
        """
        rest = memoryview(data)
        try:
            while rest:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            raise disk_error(self.path.parent, error) from error

    def require_free_space(self, size: int) -> None:
        """Raise UserFacingError unless the disk has room for `size` more bytes."""
        free = free_disk_bytes(self.path.parent)
        if free < size:
            raise UserFacingError(
                f"{self.path.parent}: {size / 1e9:.2f} GB are needed and {free / 1e9:.2f} GB are "
                "free; free some space or name another folder with --output"
            )

    def discard(self) -> None:
        """Remove the file and its metadata."""
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

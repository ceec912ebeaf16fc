"""Files and folders: atomic writes, rotation, locks, and checks of disk space and permissions."""

import errno
import fcntl
import os
import re
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


def atomic_write(path: Path, data: bytes) -> None:
    """Write a file under a temporary name, then rename it, so that no reader sees half a file.

    A kill at any moment is safe. The data are not flushed to the disk: after a power cut the newest
    files may be empty.

    Raises:
        OSError: The file cannot be written; nothing is left behind.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


class AppendOnlyFile:
    """A text file that grows by whole lines only."""

    def __init__(self, path: Path, header: str) -> None:
        """Create the file with `header` as a comment in its first line. Raises OSError."""
        self.path = path
        self._size = 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        self.append(f"# {header}")

    def append(self, line: str) -> None:
        """Append one line. Raises OSError and leaves the file unchanged if that fails."""
        data = f"{line}\n".encode()
        try:
            # One call writes the whole line, so a kill cannot split it; only a full disk can.
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError:
            os.ftruncate(self._fd, self._size)
            raise
        self._size = os.fstat(self._fd).st_size

    def close(self) -> None:
        """Close the file; nothing is buffered."""
        os.close(self._fd)


# Suffix of incomplete files and folders.
PARTIAL_SUFFIX = ".part"


def is_disk_full(error: OSError) -> bool:
    """Whether the disk, the quota or the file size limit is exhausted."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def free_disk_bytes(folder: Path) -> int:
    """Return the free bytes on the folder's disk. Raises OSError.

    A file system that reports no size (/proc, some network file systems) counts as never full.
    """
    usage = shutil.disk_usage(folder)
    return usage.free if usage.total else sys.maxsize


def check_writable(folder: Path) -> str:
    """Return why a folder cannot be written to, or "" if it can.

    The folder need not exist. Nothing is created or written.
    """
    for ancestor in (folder, *folder.absolute().parents):
        try:
            is_folder = stat.S_ISDIR(ancestor.stat().st_mode)
        except FileNotFoundError:
            continue
        except OSError as error:
            return f"{folder}: cannot be used: {error.strerror}"
        if not is_folder:
            return f"{folder}: cannot be used: {ancestor} is not a folder"
        if not os.access(ancestor, os.R_OK | os.W_OK | os.X_OK):
            return f"{folder}: cannot be used: no permission to write to {ancestor}"
        return ""
    return f"{folder}: cannot be used"


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold the lock of a folder. Raises BlockingIOError if another process holds it."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(fd)


def folder_size_bytes(folder: Path) -> int:
    """Return the bytes of all files below a folder; files that disappear meanwhile are skipped."""
    total = 0
    for subfolder, _, files in os.walk(folder):
        for name in files:
            with suppress(OSError):
                total += (Path(subfolder) / name).lstat().st_size
    return total


def describe_write_error(error: BaseException) -> str:
    """Describe a failed write; the operating system's error, if there is one, comes first."""
    cause = error if isinstance(error, OSError) else error.__cause__
    if not isinstance(cause, OSError):
        return str(error)
    if is_disk_full(cause):
        return "the disk is full; free some space"
    return f"cannot be written: {cause.strerror}"


def rotate_file(path: Path, max_files: int) -> None:
    """Rename an existing file to FILE-NNNN and delete the oldest, so that `max_files` remain.

    The limit includes the new file. A higher number is newer. Raises OSError.
    """
    numbers = sorted(_rotation_numbers(path))
    if path.is_file():
        numbers.append(numbers[-1] + 1 if numbers else 1)
        path.rename(_rotated_path(path, numbers[-1]))
    for number in numbers[: max(0, len(numbers) - max_files + 1)]:
        _rotated_path(path, number).unlink()


def _rotation_numbers(path: Path) -> list[int]:
    pattern = re.compile(re.escape(path.stem) + r"-(\d{4,})" + re.escape(path.suffix))
    matches = (pattern.fullmatch(file.name) for file in path.parent.iterdir() if file.is_file())
    return [int(match[1]) for match in matches if match]


def _rotated_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number:04d}{path.suffix}")

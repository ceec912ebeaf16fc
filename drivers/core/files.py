"""Writing so that a reader never sees half of anything, whenever this process may be killed."""

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
    """Write a file under a temporary name, then give it its own. Raises OSError, leaving nothing.

    Survives a kill at any moment; not flushed to the disk itself, so after a power cut the newest
    files may be empty.
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
        """Create the file with a comment as its first line. Raises OSError."""
        self.path = path
        self._size = 0
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666)
        self.append(f"# {header}")

    def append(self, line: str) -> None:
        """Add one line, or raise OSError and leave the file as it was."""
        data = f"{line}\n".encode()
        try:
            # One call, so a kill cannot come between two halves; a full disk can.
            while data:
                data = data[os.write(self._fd, data) :]
        except OSError:
            os.ftruncate(self._fd, self._size)
            raise
        self._size = os.fstat(self._fd).st_size

    def close(self) -> None:
        """Close the file; nothing is buffered."""
        os.close(self._fd)


# Ending of the name of what is not whole yet.
PARTIAL_SUFFIX = ".part"


def is_disk_full(error: OSError) -> bool:
    """Whether there is no space left: on the disk, in a quota, or up to a limit of file sizes."""
    return error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def free_disk_bytes(folder: Path) -> int:
    """Bytes that are free on the folder's disk. Raises OSError.

    A file system without a size, as /proc and some on a network are, is never full by this.
    """
    usage = shutil.disk_usage(folder)
    return usage.free if usage.total else sys.maxsize


def check_writable(folder: Path) -> str:
    """Why nothing can be kept in a folder, which may be yet to be made; "" if it can.

    Nothing is made or written.
    """
    for place in (folder, *folder.absolute().parents):
        try:
            is_folder = stat.S_ISDIR(place.stat().st_mode)
        except FileNotFoundError:
            continue
        except OSError as error:
            return f"{folder}: cannot be used: {error.strerror}"
        if not is_folder:
            return f"{folder}: cannot be used: {place} is no folder"
        if not os.access(place, os.R_OK | os.W_OK | os.X_OK):
            return f"{folder}: cannot be used: {place} may not be written to"
        return ""
    return f"{folder}: cannot be used"


@contextmanager
def lock_folder(folder: Path) -> Iterator[None]:
    """Hold a folder's lock. Raises BlockingIOError if another process holds it."""
    fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(fd)


def folder_size_bytes(folder: Path) -> int:
    """Bytes of all files below a folder; of one that is going away, those still there."""
    total = 0
    for place, _, files in os.walk(folder):
        for name in files:
            with suppress(OSError):
                total += (Path(place) / name).lstat().st_size
    return total


def describe_write_error(error: BaseException) -> str:
    """What is wrong; the disk's own answer where there is one, as nothing of the folder is left."""
    cause = error if isinstance(error, OSError) else error.__cause__
    if not isinstance(cause, OSError):
        return str(error)
    if is_disk_full(cause):
        return "the disk is full; free some space"
    return f"cannot be written: {cause.strerror}"


def rotate_file(path: Path, max_files: int) -> None:
    """Make room for a new file: name the one that is there FILE-NNNN, delete the oldest.

    The higher the number, the newer. Raises OSError.
    """
    numbers = sorted(_rotation_numbers(path))
    if path.is_file():
        numbers.append(numbers[-1] + 1 if numbers else 1)
        path.rename(_rotated_path(path, numbers[-1]))
    for number in numbers[: max(0, len(numbers) - max_files + 1)]:
        _rotated_path(path, number).unlink()


def _rotation_numbers(path: Path) -> list[int]:
    form = re.compile(re.escape(path.stem) + r"-(\d{4,})" + re.escape(path.suffix))
    found = (form.fullmatch(each.name) for each in path.parent.iterdir() if each.is_file())
    return [int(each[1]) for each in found if each]


def _rotated_path(path: Path, number: int) -> Path:
    return path.with_name(f"{path.stem}-{number:04d}{path.suffix}")

"""Folders that are written into: whether they can be, by whom, how full they and their disk are."""

import errno
import fcntl
import os
import shutil
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

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

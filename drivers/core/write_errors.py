"""Errors of files that cannot be written: each names its file, the cause and what to do.

The operating system's error of a write has no file name. `writing` adds it, so that every message
about a full, read-only or removed folder names the right file, wherever it is caught.
"""

import errno
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryFile

from drivers.core import InputError, UserFacingError

_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# The name itself cannot be that of a new file: a retry does not help.
_WRONG_NAME = (errno.EEXIST, errno.EISDIR, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP)
_ADVICE: dict[int | None, str] = {
    **dict.fromkeys(_WRONG_NAME, "use another name"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "use a folder that you may write to"),
    errno.ENOENT: "check its folder",
    errno.EPIPE: "its reader has ended",
}


class WriteError(OSError, UserFacingError):
    """A file or folder cannot be written; made by `WriteError.of` or `writing`."""

    _text = ""

    @classmethod
    def of(cls, path: Path, error: OSError, remark: str = "") -> "WriteError":
        """Return the error with a file's name.

        Args:
            path: The file or folder, as the user knows it.
            remark: What became of the data so far.
        """
        cause = error.strerror or str(error)
        named = cls(error.errno, cause, str(path))
        what, advice = _explain(path, error, cause)
        named._text = "; ".join(filter(None, (f"{path}: {what}", remark, advice)))
        return named

    def __str__(self) -> str:
        return self._text or super().__str__()


def _explain(path: Path, error: OSError, cause: str) -> tuple[str, str]:
    if is_disk_full(error):
        return f"the disk is full ({cause})", "free some space"
    if _has_no_folder(path, error):
        return f"cannot be written: there is no folder {path.parent}", "create it first"
    return f"cannot be written: {cause}", _ADVICE.get(error.errno, "check the disk")


def _has_no_folder(path: Path, error: OSError) -> bool:
    return error.errno == errno.ENOENT and not os.access(path.parent, os.F_OK)


@contextmanager
def writing(path: Path, remark: str = "") -> Iterator[None]:
    """Turn an OSError of the block into a `WriteError` about `path`.

    The outermost file or folder is named: it is the one that the user knows.

    Args:
        path: The file or folder that the block writes.
        remark: What became of the data so far.
    """
    try:
        yield
    except OSError as error:
        if isinstance(error, WriteError) and error.filename == str(path) and not remark:
            raise
        raise WriteError.of(path, error, remark) from error


@contextmanager
def creating(path: Path) -> Iterator[None]:
    """As `writing`, at the start: a name that no new file can have is an InputError."""
    try:
        yield
    except OSError as error:
        named = WriteError.of(path, error)
        if error.errno in _WRONG_NAME or _has_no_folder(path, error):
            raise InputError(str(named)) from error
        raise named from error


def create_output_folder(folder: Path) -> None:
    """Create the folder of --output if it does not exist, and check that it takes new files.

    Raises:
        InputError: No folder can have this name.
        WriteError: It cannot be written.
    """
    with creating(folder):
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()


def check_output_file(path: Path) -> None:
    """Check before the work that a file can be written; an existing file stays as it is.

    Raises:
        InputError: No file can have this name.
        WriteError: Its folder cannot be written.
    """
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "not a regular file"
        raise InputError(f"{path}: is {kind}; name a file")
    with creating(path):
        TemporaryFile(dir=path.parent).close()


def check_in_place(fd: int, path: Path) -> None:
    """Raise OSError if an open file is no longer at its path: nobody would find what is written."""
    with suppress(OSError):
        if os.path.samestat(os.fstat(fd), path.stat()):
            return
    raise FileNotFoundError(errno.ENOENT, "it was removed or renamed while it was written")


def check_disk_space(folder: Path, needed_bytes: int) -> None:
    """Raise OSError, as for a full disk, unless this many bytes are free on the folder's disk."""
    if free_disk_bytes(folder) < needed_bytes:
        raise OSError(errno.ENOSPC, f"less than {needed_bytes / 1e9:.2g} GB are left")


def check_growth(path: Path) -> None:
    """Raise OSError if the disk, a quota or a limit refuses another megabyte of a file.

    For a library that does not say why it cannot write.
    """
    with TemporaryFile(dir=path.parent) as probe:
        probe.seek(path.stat().st_size if path.is_file() else 0)
        probe.write(bytes(1_000_000))
        probe.flush()


def is_disk_full(error: BaseException) -> bool:
    """Whether the disk, the quota or the file size limit is exhausted."""
    return isinstance(error, OSError) and error.errno in _DISK_FULL


def free_disk_bytes(folder: Path) -> int:
    """Return the free bytes on the folder's disk. Raises OSError.

    A file system that reports no size (/proc, some network file systems) counts as never full.
    """
    usage = shutil.disk_usage(folder)
    return usage.free if usage.total else sys.maxsize

"""Files that a user names: opened only if they are regular files; text in UTF-8 or UTF-16."""

import codecs
import errno
import os
import stat
import sys
from io import BufferedReader
from pathlib import Path

from drivers.core import InputError

_KINDS = {stat.S_IFDIR: "a folder", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
_UTF16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def open_input(path: Path) -> BufferedReader:
    """Open a regular file for reading.

    Raises:
        OSError: It cannot be opened, or it is something else: a pipe could block forever, and a
            device may have no end.
    """
    mode = path.stat().st_mode
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "a device")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    return path.open("rb")


def read_input(path: Path) -> bytes:
    """Read a regular file. Raises OSError as `open_input`."""
    with open_input(path) as file:
        return file.read()


def read_input_text(path: Path, advice: str, max_bytes: int = sys.maxsize) -> str:
    """Read a text file in UTF-8, or in UTF-16 with a byte order mark, with newlines as line ends.

    Args:
        advice: End of an error message: what to do.
        max_bytes: Longest file, so that a recording that is named by mistake is not loaded.

    Raises:
        InputError: It cannot be read or is too large, or it is not text, with the line.
    """
    try:
        with open_input(path) as file:
            if os.fstat(file.fileno()).st_size > max_bytes:
                raise InputError(f"{path}: has more than {max_bytes} bytes; {advice}")
            data = file.read()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; {advice}") from error
    try:
        text = data.decode("utf-16" if data.startswith(_UTF16_MARKS) else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}:{line}: is not UTF-8 text ({error.reason}); {advice}") from error
    return text.replace("\r\n", "\n").replace("\r", "\n")

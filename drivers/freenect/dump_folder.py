"""Whether a folder is one that fakenect can play."""

import re
from pathlib import Path

import numpy as np

from drivers.errors import InputError

INDEX_FILE = "INDEX.txt"
NO_DEPTH_RAW = 2047
# One line of text, then the pixels; "a" is the accelerometer, of any size.
PIXEL_BYTES = {"d": 480 * 640 * 2, "r": 480 * 640 * 3, "a": 0}
_FILE_NAME = re.compile(r"([dra])-[0-9.]+-[0-9]+\.[a-z]+")


def check_dump_folder(folder: Path) -> None:
    """Raises InputError where fakenect would end the process, and for raw 11-bit depth."""
    names = _read_index(folder)
    for name in names:
        _check_file(folder / name)
    for kind, what in (("d", "depth"), ("r", "colour")):
        if not any(name.startswith(kind) for name in names):
            raise InputError(f"{folder / INDEX_FILE}: names no {what} image; record the dump again")
    _check_unit(folder / next(name for name in names if name.startswith("d")))


def _read_index(folder: Path) -> list[str]:
    index = folder / INDEX_FILE
    try:
        lines = index.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{index}: cannot be read ({_error_text(error)}); a dump is a folder with {INDEX_FILE} and the "
            "files that it names"
        ) from error
    names = lines[:-1] if lines[-1] == "" else lines
    for number, name in enumerate(names, start=1):
        if not _FILE_NAME.fullmatch(name):
            raise InputError(
                f"{index}:{number}: {name!r} is not d-, r- or a-, time, stamp and ending, as in "
                "d-1234.567-890.pgm; record the dump again"
            )
    return names


def _check_file(path: Path) -> None:
    pixels = PIXEL_BYTES[path.name[0]]
    if not pixels:
        _read_header(path, 0)
        return
    header = _read_header(path, pixels)
    if not header.endswith(b"\n") or header.count(b"\n") != 1:
        raise InputError(
            f"{path}: is not one line of text and then {pixels} bytes of a 640x480 image; record "
            "the dump again"
        )


def _read_header(path: Path, pixel_bytes: int) -> bytes:
    """What stands before the pixels; b"" if there is less than that."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            return file.read(max(0, size - pixel_bytes))[:1000]
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({_error_text(error)}); {INDEX_FILE} names it"
        ) from error


def _check_unit(path: Path) -> None:
    depth = np.frombuffer(path.read_bytes()[-PIXEL_BYTES["d"] :], dtype="<u2")
    if depth.max() == NO_DEPTH_RAW:
        raise InputError(
            f"{path}: holds raw 11-bit depth, as fakenect-record writes it; only a dump of "
            "registered depth in millimetres can be played"
        )


def _error_text(error: OSError | UnicodeDecodeError) -> str:
    return error.strerror or "" if isinstance(error, OSError) else "not a text"

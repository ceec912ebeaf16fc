"""Whether a folder is one that fakenect can play."""

import re
from pathlib import Path

import numpy as np

from drivers.errors import InputError

INDEX = "INDEX.txt"
NO_RAW_DEPTH = 2047
# One line of text, then the pixels; "a" is the accelerometer, of any size.
PIXEL_BYTES = {"d": 480 * 640 * 2, "r": 480 * 640 * 3, "a": 0}
_NAME = re.compile(r"([dra])-[0-9.]+-[0-9]+\.[a-z]+")


def check_dump(folder: Path) -> None:
    """Raises InputError where fakenect would end the process, and for raw 11-bit depth."""
    names = _names(folder)
    for name in names:
        _check_file(folder / name)
    for kind, what in (("d", "depth"), ("r", "colour")):
        if not any(name.startswith(kind) for name in names):
            raise InputError(f"{folder / INDEX}: names no {what} image; record the dump again")
    _check_unit(folder / next(name for name in names if name.startswith("d")))


def _names(folder: Path) -> list[str]:
    index = folder / INDEX
    try:
        lines = index.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"{index}: cannot be read ({_why(error)}); a dump is a folder with {INDEX} and the "
            "files that it names"
        ) from error
    names = lines[:-1] if lines[-1] == "" else lines
    for number, name in enumerate(names, start=1):
        if not _NAME.fullmatch(name):
            raise InputError(
                f"{index}:{number}: {name!r} is not d-, r- or a-, time, stamp and ending, as in "
                "d-1234.567-890.pgm; record the dump again"
            )
    return names


def _check_file(path: Path) -> None:
    pixels = PIXEL_BYTES[path.name[0]]
    if not pixels:
        _header(path, 0)
        return
    header = _header(path, pixels)
    if not header.endswith(b"\n") or header.count(b"\n") != 1:
        raise InputError(
            f"{path}: is not one line of text and then {pixels} bytes of a 640x480 image; record "
            "the dump again"
        )


def _header(path: Path, pixels: int) -> bytes:
    """What stands before the pixels; b"" if there is less than that."""
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            return file.read(max(0, size - pixels))[:1000]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({_why(error)}); {INDEX} names it") from error


def _check_unit(path: Path) -> None:
    depth = np.frombuffer(path.read_bytes()[-PIXEL_BYTES["d"] :], dtype="<u2")
    if depth.max() == NO_RAW_DEPTH:
        raise InputError(
            f"{path}: holds raw 11-bit depth, as fakenect-record writes it; only a dump of "
            "registered depth in millimetres can be played"
        )


def _why(error: OSError | UnicodeDecodeError) -> str:
    return error.strerror or "" if isinstance(error, OSError) else "not a text"

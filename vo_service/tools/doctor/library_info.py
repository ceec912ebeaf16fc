"""Files of native libraries. Imports little, because it runs in a subprocess."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class LibraryInfo:
    """One library: the file that was loaded, or the error."""

    name: str
    file: str
    error: str


def load_libraries(names: Sequence[str]) -> list[LibraryInfo]:
    """Load libraries into this process in the given order, as the drivers do."""
    return [_load_library(name) for name in names]


def _load_library(name: str) -> LibraryInfo:
    try:
        ctypes.CDLL(name)
    except OSError as error:
        return LibraryInfo(name, "", str(error))
    # The file that the loader took; a search could find another one.
    stem = name.partition(".so")[0] + ".so"
    lines = Path("/proc/self/maps").read_text().splitlines()
    files = [line.split(maxsplit=5)[5] for line in lines if "/" in line]
    return LibraryInfo(
        name, next((file for file in files if Path(file).name.startswith(stem)), ""), ""
    )

"""Loading native libraries to see which files they are. Imports little: it runs in a child."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Loaded:
    """What became of a library: the file that is in memory, or why there is none."""

    name: str
    file: str
    error: str


def load(names: Sequence[str]) -> list[Loaded]:
    """Load libraries into this process, in order, as the drivers do."""
    return [_load(name) for name in names]


def _load(name: str) -> Loaded:
    try:
        ctypes.CDLL(name)
    except OSError as error:
        return Loaded(name, "", str(error))
    # Not the file that a search would find: the one that the loader took.
    stem = name.partition(".so")[0] + ".so"
    lines = Path("/proc/self/maps").read_text().splitlines()
    files = [line.split(maxsplit=5)[5] for line in lines if "/" in line]
    return Loaded(name, next((file for file in files if Path(file).name.startswith(stem)), ""), "")

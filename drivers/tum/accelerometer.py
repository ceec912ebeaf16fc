"""The file ``accelerometer.txt`` of a TUM folder, with lines of ``timestamp ax ay az``."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.core.errors import InputError
from drivers.core.files import AppendOnlyFile
from drivers.core.geometry import Array
from drivers.core.gravity import (
    Vector,
    accelerometer_from_gravity,
    gravity_from_accelerometer,
    is_gravity,
)
from drivers.tum.index_files import read_rows

ACCELEROMETER_FILE = "accelerometer.txt"
COLUMNS = "timestamp ax ay az"
AVERAGING_WINDOW_S = 1.0


@dataclass(frozen=True)
class GravitySeries:
    """Gravity in camera axes, (N, 3) m/s^2, at rising stamps (N,)."""

    stamps_s: Array
    gravity_m_s2: Array

    def mean_at(self, stamp_s: float) -> Vector | None:
        """Return the reading with this stamp, else the mean of the second before; None without any.

        This program's recordings have one reading per frame, which is already smoothed.
        """
        end = int(np.searchsorted(self.stamps_s, stamp_s, side="right"))
        begin = int(np.searchsorted(self.stamps_s, stamp_s - AVERAGING_WINDOW_S))
        if end == begin:
            return None
        if self.stamps_s[end - 1] == stamp_s:
            begin = end - 1
        x, y, z = self.gravity_m_s2[begin:end].mean(axis=0).tolist()
        return (x, y, z)


def read_gravity(folder: Path) -> GravitySeries:
    """Read a folder's gravity without invalid readings; empty if there is no such file.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    path = folder / ACCELEROMETER_FILE
    rows = read_rows(path, COLUMNS) if path.exists() else []
    readings = [_parse_reading(words, f"{path}:{number}") for number, words in rows]
    table = np.array([(s, *g) for s, g in readings if is_gravity(g)]).reshape(-1, 4)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return GravitySeries(table[:, 0], table[:, 1:])


class AccelerometerWriter:
    """Writes the file, which is created with the first reading."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / ACCELEROMETER_FILE
        self._files: list[AppendOnlyFile] = []

    def add(self, stamp: str, gravity_m_s2: Vector | None) -> None:
        """Add a line; `read_gravity` gives back exactly the same gravity. Raises OSError."""
        if gravity_m_s2 is None:
            return
        if not self._files:
            self._files.append(AppendOnlyFile(self._path, COLUMNS))
        values = accelerometer_from_gravity(gravity_m_s2)
        self._files[0].append(" ".join([stamp, *(repr(float(value)) for value in values)]))

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        while self._files:
            self._files.pop().close()


def _parse_reading(words: list[str], location: str) -> tuple[float, Vector]:
    try:
        stamp_s, x, y, z = map(float, words)
    except ValueError as error:
        raise InputError(
            f"{location}: {' '.join(words)!r} is not {COLUMNS}, all numbers"
        ) from error
    if not all(map(math.isfinite, (stamp_s, x, y, z))):
        raise InputError(f"{location}: a number is not finite; remove the line")
    return stamp_s, gravity_from_accelerometer((x, y, z))

"""``accelerometer.txt`` of a TUM folder: ``timestamp ax ay az``, as a Kinect's accelerometer."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.errors import InputError
from drivers.geometry import Array
from drivers.gravity import (
    Vector,
    accelerometer_from_gravity,
    gravity_from_accelerometer,
    is_gravity,
)
from drivers.tum.lists import words_of_list
from drivers.tum.whole_files import GrowingList

FILE_NAME = "accelerometer.txt"
FORM = "timestamp ax ay az"
SMOOTHED_OVER_S = 1.0


@dataclass(frozen=True)
class GravityTrack:
    """Gravity in camera axes, (N, 3) m/s^2, at rising stamps (N,)."""

    stamps_s: Array
    gravity_m_s2: Array

    def at(self, stamp_s: float) -> Vector | None:
        """The reading of this very stamp, else the mean of the second before; None without any.

        A recording made here has one reading a frame, which was smoothed when it was live.
        """
        end = int(np.searchsorted(self.stamps_s, stamp_s, side="right"))
        begin = int(np.searchsorted(self.stamps_s, stamp_s - SMOOTHED_OVER_S))
        if end == begin:
            return None
        if self.stamps_s[end - 1] == stamp_s:
            begin = end - 1
        x, y, z = self.gravity_m_s2[begin:end].mean(axis=0).tolist()
        return (x, y, z)


def read_gravity(folder: Path) -> GravityTrack:
    """The folder's track, without what cannot be gravity; empty where there is no such file.

    Raises InputError naming file and line if it does not parse.
    """
    path = folder / FILE_NAME
    rows = words_of_list(path, FORM) if path.exists() else []
    readings = [_reading(words, f"{path}:{number}") for number, words in rows]
    table = np.array([(s, *g) for s, g in readings if is_gravity(g)]).reshape(-1, 4)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return GravityTrack(table[:, 0], table[:, 1:])


class AccelerometerList:
    """Writes the file; there is none before there is a reading."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE_NAME
        self._lists: list[GrowingList] = []

    def add(self, stamp: str, gravity_m_s2: Vector | None) -> None:
        """Add a line, from which exactly the same gravity is read. Raises OSError."""
        if gravity_m_s2 is None:
            return
        if not self._lists:
            self._lists.append(GrowingList(self._path, FORM))
        values = accelerometer_from_gravity(gravity_m_s2)
        self._lists[0].append(" ".join([stamp, *(repr(float(value)) for value in values)]))

    def close(self) -> None:
        """Close the file. Safe to call twice."""
        while self._lists:
            self._lists.pop().close()


def _reading(words: list[str], where: str) -> tuple[float, Vector]:
    try:
        stamp_s, x, y, z = map(float, words)
    except ValueError as error:
        raise InputError(f"{where}: {' '.join(words)!r} is not {FORM}, all numbers") from error
    if not all(map(math.isfinite, (stamp_s, x, y, z))):
        raise InputError(f"{where}: a number is not finite; remove the line")
    return stamp_s, gravity_from_accelerometer((x, y, z))

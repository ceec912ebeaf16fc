"""The file of a TUM folder with the readings of the accelerometer."""

import math
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import Vector, accelerometer_from_gravity, gravity_from_accelerometer
from drivers.recording.accelerometer import AccelerometerSeries
from drivers.tum.index_files import read_rows

ACCELEROMETER_FILE = "accelerometer.txt"
ACCELEROMETER_COLUMNS = "timestamp ax ay az"


def read_accelerometer(folder: Path) -> AccelerometerSeries:
    """Read a folder's readings of the accelerometer; empty if there is no such file.

    Raises:
        InputError: The file does not parse; the message names file and line.
    """
    path = folder / ACCELEROMETER_FILE
    rows = read_rows(path, ACCELEROMETER_COLUMNS) if path.exists() else []
    readings = [_parse_reading(words, f"{path}:{number}") for number, words in rows]
    table = np.array([(s, *g) for s, g in readings]).reshape(-1, 4)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return AccelerometerSeries(table[:, 0], -table[:, 1:])


def format_reading(gravity_m_s2: Vector) -> str:
    """Format a line without its stamp; `read_accelerometer` gives back exactly the same."""
    return " ".join(repr(float(value)) for value in accelerometer_from_gravity(gravity_m_s2))


def _parse_reading(words: list[str], location: str) -> tuple[float, Vector]:
    try:
        stamp_s, x, y, z = map(float, words)
    except ValueError as error:
        raise InputError(
            f"{location}: {' '.join(words)!r} is not {ACCELEROMETER_COLUMNS}, all numbers"
        ) from error
    if not all(map(math.isfinite, (stamp_s, x, y, z))):
        raise InputError(f"{location}: a number is not finite; remove the line")
    return stamp_s, gravity_from_accelerometer((x, y, z))

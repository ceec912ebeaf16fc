"""Trajectories in the TUM RGB-D benchmark's text format: ``stamp tx ty tz qx qy qz qw`` a line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import InputError
from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose

COLUMNS = "stamp tx ty tz qx qy qz qw"
# Beyond these a file is in other units: nanoseconds, say.
MAX_STAMP_S = 1e11
MAX_POSITION_M = 1e9
# Stamps that lie closer than this may belong to each other.
MAX_STAMP_DIFFERENCE_S = 0.020


@dataclass(frozen=True)
class Trajectory:
    """A trajectory: `stamps_s` (N,) strictly rising, `T_world_camera` (N, 4, 4)."""

    stamps_s: Array
    T_world_camera: Array

    def __len__(self) -> int:
        return len(self.stamps_s)


def read_trajectory(path: Path) -> Trajectory:
    """Read a TUM-format file; blank lines and ``#`` comments are passed over.

    Raises InputError naming the file and line if it cannot be read, does not parse, holds NaN,
    a quaternion that is no rotation or values in other units, or if stamps repeat or go backwards.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot read the trajectory: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not a text file; expected lines of: {COLUMNS}") from error
    stamps: list[float] = []
    poses: list[Array] = []
    for number, line in enumerate(lines, 1):
        text = line.split("#", 1)[0].replace(",", " ").split()
        if not text:
            continue
        stamp_s, T = _parse_pose(text, f"{path}:{number}")
        if stamps and stamp_s <= stamps[-1]:
            raise InputError(
                f"{path}:{number}: stamp {text[0]} does not come after the one before "
                f"({stamps[-1]:.6f}): sort the file by its first column and remove repeats"
            )
        stamps.append(stamp_s)
        poses.append(T)
    if not poses:
        raise InputError(f"{path}: holds no pose; expected lines of: {COLUMNS}")
    return Trajectory(np.array(stamps), np.array(poses))


def format_pose_line(stamp_s: float, T_world_camera: Array) -> str:
    """One line of a trajectory file, with its newline. Microseconds, 0.1 um, 1e-9 of a rotation."""
    q = quaternion_from_rotation(T_world_camera[:3, :3])
    position = " ".join(f"{v:.7f}" for v in T_world_camera[:3, 3])
    return f"{stamp_s:.6f} {position} {' '.join(f'{v:.9f}' for v in q)}\n"


def _parse_pose(text: list[str], where: str) -> tuple[float, Array]:
    if len(text) != 8:
        raise InputError(f"{where}: {len(text)} columns where 8 are expected: {COLUMNS}")
    try:
        values = [float(word) for word in text]
    except ValueError as error:
        raise InputError(f"{where}: {error}; expected numbers: {COLUMNS}") from error
    if not np.all(np.isfinite(values)):
        raise InputError(f"{where}: a value is not finite: remove the line, a lost pose has none")
    if abs(values[0]) > MAX_STAMP_S or max(map(abs, values[1:4])) > MAX_POSITION_M:
        raise InputError(
            f"{where}: stamps must be in seconds and positions in metres; convert them"
        )
    try:
        return values[0], transform_from_pose(values[1:4], values[4:8])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def nearest_indices(stamps_s: Array, query_s: Array) -> NDArray[np.intp]:
    """For each of `query_s`, the index of the nearest of the rising `stamps_s`; ties: earlier."""
    after = np.searchsorted(stamps_s, query_s, side="right").clip(max=len(stamps_s) - 1)
    before = (after - 1).clip(min=0)
    is_before = query_s - stamps_s[before] <= stamps_s[after] - query_s
    return np.where(is_before, before, after)


def has_match(
    stamps_s: Array, reference_s: Array, max_difference_s: float = MAX_STAMP_DIFFERENCE_S
) -> NDArray[np.bool_]:
    """For each of `stamps_s`, whether one of the rising `reference_s` is within reach."""
    return (
        np.abs(reference_s[nearest_indices(reference_s, stamps_s)] - stamps_s) <= max_difference_s
    )

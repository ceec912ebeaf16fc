"""Trajectories in the TUM RGB-D benchmark's format: ``stamp tx ty tz qx qy qz qw`` per line."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import InputError
from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose

COLUMNS = "stamp tx ty tz qx qy qz qw"
# Larger values mean that a file is in other units, such as nanoseconds.
MAX_STAMP_S = 1e11
MAX_POSITION_M = 1e9
# The largest difference of two stamps of the same instant.
MAX_STAMP_DIFFERENCE_S = 0.020


@dataclass(frozen=True)
class Trajectory:
    """A trajectory.

    Attributes:
        stamps_s: (N,), strictly rising.
        T_world_camera: (N, 4, 4), camera poses in the world frame.
    """

    stamps_s: Array
    T_world_camera: Array

    def __len__(self) -> int:
        return len(self.stamps_s)


def read_trajectory(path: Path) -> Trajectory:
    """Read a TUM-format file; blank lines and ``#`` comments are skipped.

    Raises:
        InputError: The file cannot be read or parsed, holds NaN, a quaternion that is no rotation
            or values in other units, or its stamps do not rise. The message names file and line.
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
                f"{path}:{number}: stamp {text[0]} is not after the previous one "
                f"({stamps[-1]:.6f}): sort the file by its first column and remove duplicates"
            )
        stamps.append(stamp_s)
        poses.append(T)
    if not poses:
        raise InputError(f"{path}: holds no pose; expected lines of: {COLUMNS}")
    return Trajectory(np.array(stamps), np.array(poses))


def format_pose_line(stamp_s: float, T_world_camera: Array) -> str:
    """Format one line of a trajectory file, with its newline.

    The resolution is 1 us of the stamp, 0.1 um of the position and 1e-9 of the quaternion.
    """
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
        raise InputError(f"{where}: a value is not finite: remove the line")
    if abs(values[0]) > MAX_STAMP_S or max(map(abs, values[1:4])) > MAX_POSITION_M:
        raise InputError(
            f"{where}: stamps must be in seconds and positions in meters; convert them"
        )
    try:
        return values[0], transform_from_pose(values[1:4], values[4:8])
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error


def nearest_indices(stamps_s: Array, query_s: Array) -> NDArray[np.intp]:
    """Return the index of the nearest of the rising `stamps_s` for each query.

    Of two equally near stamps the earlier one is taken.
    """
    after = np.searchsorted(stamps_s, query_s, side="right").clip(max=len(stamps_s) - 1)
    before = (after - 1).clip(min=0)
    is_before = query_s - stamps_s[before] <= stamps_s[after] - query_s
    return np.where(is_before, before, after)


def has_match(
    stamps_s: Array, reference_s: Array, max_difference_s: float = MAX_STAMP_DIFFERENCE_S
) -> NDArray[np.bool_]:
    """Return for each stamp whether one of the rising `reference_s` is near enough."""
    return (
        np.abs(reference_s[nearest_indices(reference_s, stamps_s)] - stamps_s) <= max_difference_s
    )

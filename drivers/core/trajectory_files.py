"""Trajectory files in the formats of several projects, recognized by their first line.

| format | a pose |
|---|---|
| TUM | ``stamp tx ty tz qx qy qz qw``, seconds |
| EuRoC | ``stamp,tx,ty,tz,qw,qx,qy,qz,...``, nanoseconds; the quaternion begins with w |
| ORB-SLAM3's EuRoC | as TUM, but nanoseconds |
| KITTI | 12 numbers: the upper three rows of the 4x4 pose; the stamps are elsewhere |
| Redwood, Open3D | three integers, first the frame's number; four rows of the pose |
| ICL-NUIM | as TUM, with the frame's number as the stamp, and with the y axes upwards |

All poses are of the camera (or body) in the world.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from drivers.core import InputError
from drivers.core.geometry import (
    MAX_STAMP_S,
    Array,
    Trajectory,
    is_rigid,
    make_trajectory,
    orthonormalize,
    parse_pose,
    read_trajectory_rows,
)
from drivers.core.input_files import read_input_text

# Of files without stamps: all that are read are of sensors with this rate.
ASSUMED_RATE_HZ = 30
ICL_NUIM_SUFFIX = ".gt.freiburg"
# Rotation matrices are written with few digits.
MAX_ROTATION_ERROR = 1e-2
# Shortest median time between poses whose stamps are taken for nanoseconds.
MIN_INTERVAL_S = 1e-4
# Of the median step; cars are slower, and hands move a camera by 100 mm/s and more.
MAX_SPEED_M_S = 60.0
# ICL-NUIM's y axes, those of the camera and of the world, point up. That is a left-handed system.
MIRRORED_Y = np.diag([1.0, -1.0, 1.0, 1.0])

Row = tuple[str, list[str]]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class TrajectoryFile:
    """The poses of a file, and what they were taken for; "" for the TUM format."""

    poses: Trajectory
    note: str


def assumed_stamp(frame_number: int) -> Decimal:
    """Return the stamp of a frame at 30 Hz, to the microsecond."""
    return round(Decimal(frame_number) / ASSUMED_RATE_HZ, 6)


def read_trajectory_file(path: Path, frames_s: Array | None = None) -> TrajectoryFile:
    """Read a trajectory in any of the formats above.

    Args:
        frames_s: (F,) stamps of the recording's frames, for formats without stamps; None = 30 Hz.

    Raises:
        InputError: The file cannot be read or parsed; the message names file and line.
    """
    found = _read_any_format(path, frames_s)
    warn_of_speed(path, found.poses)
    return found


def warn_of_speed(path: Path, poses: Trajectory) -> None:
    """Log a warning if the positions of a file cannot be in meters."""
    if fault := find_speed_fault(poses):
        _log.warning("%s: %s", path, fault)


def find_speed_fault(poses: Trajectory) -> str:
    """Return why positions cannot be in meters; "" if they can."""
    steps_m = np.linalg.norm(np.diff(poses.T_world_camera[:, :3, 3], axis=0), axis=1)
    speed_m_s = np.median(steps_m / np.diff(poses.stamps_s)) if len(steps_m) else 0.0
    if speed_m_s <= MAX_SPEED_M_S:
        return ""
    return (
        f"the camera moves at {speed_m_s:.0f} m/s; if the positions are not in meters but in "
        "millimeters, divide them by 1000"
    )


def _read_any_format(path: Path, frames_s: Array | None) -> TrajectoryFile:
    rows = read_trajectory_rows(path)
    columns = [len(words) for _, words in rows[:2]]
    if columns[0] == 12:
        return _read_kitti(path, rows, frames_s)
    if columns == [3, 4]:
        return _read_redwood(path, rows, frames_s)
    if path.name.endswith(ICL_NUIM_SUFFIX):
        return TrajectoryFile(read_icl_nuim_trajectory(path), "ICL-NUIM format, 30 Hz assumed")
    if _is_nanoseconds(rows[-1][1][0]):
        return _read_nanoseconds(path, rows)
    return TrajectoryFile(make_trajectory([(at, *parse_pose(words, at)) for at, words in rows]), "")


def read_icl_nuim_trajectory(path: Path) -> Trajectory:
    """Read ICL-NUIM's true poses. Raises as `read_trajectory_file`."""
    poses = []
    for where, words in read_trajectory_rows(path):
        number, T = parse_pose(words, where)
        if number != int(number):
            raise InputError(
                f"{where}: {words[0]} is not the number of a frame, as ICL-NUIM has it; rename the "
                "file to groundtruth.txt if these are seconds"
            )
        poses.append((where, float(assumed_stamp(int(number))), MIRRORED_Y @ T @ MIRRORED_Y))
    return make_trajectory(poses)


def pose_from_matrix(words: Sequence[str] | Sequence[float], where: str) -> Array:
    """Make a 4x4 pose of the numbers of its rows, 12 or 16.

    Raises:
        InputError: They are not numbers, or not a rigid transform.
    """
    try:
        numbers = [float(word) for word in words]
    except ValueError as error:
        raise InputError(f"{where}: {error}; expected the numbers of a 4x4 pose") from error
    T = np.array([*numbers, 0.0, 0.0, 0.0, 1.0][:16]).reshape(4, 4)
    if not is_rigid(T, MAX_ROTATION_ERROR):
        raise InputError(f"{where}: not a rotation and a translation; expected a 4x4 pose")
    return orthonormalize(T)


def _is_nanoseconds(word: str) -> bool:
    try:
        return float(word) > MAX_STAMP_S
    except ValueError:
        return False


def _read_nanoseconds(path: Path, rows: Sequence[Row]) -> TrajectoryFile:
    lines = read_input_text(path, "name a trajectory").splitlines()
    has_commas = any("," in line.split("#", 1)[0] for line in lines)
    order = (0, 1, 2, 3, 5, 6, 7, 4) if has_commas else range(8)
    poses = []
    for where, words in rows:
        if len(words) < 8:
            raise InputError(f"{where}: {len(words)} columns where at least 8 are expected")
        try:
            stamp = Decimal(words[0]).scaleb(-9)
        except ArithmeticError as error:
            raise InputError(f"{where}: {words[0]!r} is not a stamp in nanoseconds") from error
        ordered = [words[i] for i in order]
        poses.append((where, *parse_pose([str(stamp), *ordered[1:]], where)))
    trajectory = make_trajectory(poses)
    interval_s = np.median(np.diff(trajectory.stamps_s)) if len(poses) > 1 else np.inf
    if interval_s < MIN_INTERVAL_S:
        raise InputError(
            f"{path}: its stamps are neither seconds nor nanoseconds, which would be "
            f"{1e9 * interval_s:.0f} ns apart; write them in seconds"
        )
    first = "EuRoC format: nanoseconds, quaternion w x y z" if has_commas else "nanoseconds"
    return TrajectoryFile(trajectory, f"{first}; poses are used as they are")


def _read_kitti(path: Path, rows: Sequence[Row], frames_s: Array | None) -> TrajectoryFile:
    matrices = []
    for where, words in rows:
        if len(words) != 12:
            raise InputError(f"{where}: {len(words)} columns where 12 are expected, as above")
        matrices.append((where, pose_from_matrix(words, where)))
    stamps_s, source = _find_kitti_stamps(path, len(rows), frames_s)
    poses = [(where, s, T) for (where, T), s in zip(matrices, stamps_s, strict=True)]
    return TrajectoryFile(make_trajectory(poses), f"KITTI format, {source}")


def _find_kitti_stamps(
    path: Path, count: int, frames_s: Array | None
) -> tuple[Sequence[float], str]:
    """Return the stamps of the poses, and where they come from."""
    times = path.with_name("times.txt")
    if times.exists():
        try:
            stamps_s = [float(words[0]) for _, words in read_trajectory_rows(times)]
        except ValueError as error:
            raise InputError(f"{times}: {error}; expected one stamp in a line") from error
        if len(stamps_s) != count:
            raise InputError(
                f"{path}: has {count} poses, but {times} has {len(stamps_s)} stamps; give the two "
                "files of one sequence"
            )
        return stamps_s, f"stamps of {times}"
    if frames_s is not None and len(frames_s) == count:
        return frames_s.tolist(), "one pose for each frame"
    return [float(assumed_stamp(number)) for number in range(count)], "30 Hz assumed"


def _read_redwood(path: Path, rows: Sequence[Row], frames_s: Array | None) -> TrajectoryFile:
    poses = []
    for first in range(0, len(rows), 5):
        (where, header), *matrix = rows[first : first + 5]
        number = header[0]
        if len(header) != 3 or not (number.isdecimal() and len(number) < 10):
            raise InputError(f"{where}: expected three integers above the four rows of a pose")
        if [len(row) for _, row in matrix] != [4, 4, 4, 4]:
            raise InputError(f"{where}: below it are not the four rows of a 4x4 pose")
        T = pose_from_matrix([word for _, row in matrix for word in row], where)
        poses.append((where, int(number), T))
    if frames_s is None:
        stamped = [(where, float(assumed_stamp(number)), T) for where, number, T in poses]
        return TrajectoryFile(make_trajectory(stamped), "Redwood format, 30 Hz assumed")
    of_frames = [(at, float(frames_s[n]), T) for at, n, T in poses if n < len(frames_s)]
    return TrajectoryFile(make_trajectory(of_frames), "Redwood format, stamps of the frames")

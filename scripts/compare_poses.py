"""Compare two trajectories of the same frames, pose by pose: how `check_aarch64.sh` compares.

Usage: python -m scripts.compare_poses TRAJECTORY OTHER     in TUM format, such as replay writes
"""

import math
import sys
from pathlib import Path

import numpy as np

from drivers.core.geometry import Trajectory, pose_distance, read_trajectory

MAX_DISTANCE_M = 1e-4
MAX_ANGLE_RAD = math.radians(0.01)  # moves a point at 0.6 m by 0.1 mm


def largest_differences(one: Trajectory, other: Trajectory) -> tuple[float, float] | None:
    """Return the largest distance in meters and the largest angle in radians of two poses.

    None: the trajectories are not of the same frames.
    """
    if not np.array_equal(one.stamps_s, other.stamps_s):
        return None
    pairs = zip(one.T_world_camera, other.T_world_camera, strict=True)
    distances_m, angles_rad = zip(*(pose_distance(*pair) for pair in pairs), strict=True)
    return max(distances_m), max(angles_rad)


def main(file: str, other: str) -> None:
    """Print the result; exit with 1 if the poses are not equal within the limits."""
    trajectory = read_trajectory(Path(file))
    differences = largest_differences(trajectory, read_trajectory(Path(other)))
    if differences is None:
        sys.exit(f"{file} and {other} are not of the same frames")
    distance_m, angle_rad = differences
    print(
        f"{len(trajectory)} poses differ by at most {1e3 * distance_m:.4f} mm "
        f"and {math.degrees(angle_rad):.5f} degrees"
    )
    if distance_m > MAX_DISTANCE_M or angle_rad > MAX_ANGLE_RAD:
        limits = f"{1e3 * MAX_DISTANCE_M:g} mm or {math.degrees(MAX_ANGLE_RAD):g} degrees"
        sys.exit(f"{file} and {other} differ by more than {limits}")


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Rigid motions, rotations and the direction of gravity: conversions, distances and averages.

A line of a trajectory file is as in the TUM RGB-D benchmark: ``stamp tx ty tz qx qy qz qw``.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.core import InputError
from drivers.core.input_files import read_input_text

Array = NDArray[np.float64]
# Optical axes (x right, y down, z forward) in REP 103's (x forward, y left, z up).
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
STANDARD_GRAVITY_M_S2 = 9.80665
# A larger relative error of the length means acceleration or a fault, not gravity alone.
MAX_LENGTH_ERROR = 0.1


def rigid_transform(rotation: ArrayLike, translation_m: ArrayLike) -> Array:
    """Make a 4x4 transform from a 3x3 rotation and a translation (3,) in meters."""
    T = np.zeros((4, 4))
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    T[3, 3] = 1.0
    return T


def inverse(T: Array) -> Array:
    """Invert a rigid 4x4 transform."""
    R_inverse = T[:3, :3].T
    return rigid_transform(R_inverse, -R_inverse @ T[:3, 3])


def orthonormalize(T: Array) -> Array:
    """Remove the rounding errors of many products from a rigid 4x4 transform.

    Needed wherever products of transforms are inverted by transposing and multiplied again: the
    error then grows with each round. Two steps of Newton's iteration to the nearest rotation
    (Higham, "Computing the Polar Decomposition", 1986); the error left is of fourth order.
    """
    R, three = T[:3, :3], 3.0 * np.eye(3)
    for _ in range(2):
        R = 0.5 * R @ (three - R.T @ R)
    return rigid_transform(R, T[:3, 3])


def transform_points(T: Array, points: Array) -> Array:
    """Map (N, 3) points through a 4x4 transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def fit_rigid_motion(P: Array, Q: Array, w: Array) -> Array:
    """4x4 transform T that minimizes sum w_i |T p_i - q_i|^2; 3 points or more, not on a line.

    The five steps of Section 4 of Sorkine-Hornung and Rabinovich, "Least-Squares Rigid Motion Using
    SVD" (2017).

    Args:
        P: (N, 3) points p_i.
        Q: (N, 3) points q_i.
        w: (N,) weights.
    """
    # Step 1: the weighted centroids.
    p_mean, q_mean = w @ P / w.sum(), w @ Q / w.sum()
    # Step 2: the centered vectors.
    X, Y = P - p_mean, Q - q_mean
    # Step 3: the 3x3 covariance matrix S = X W Y^T, with points as columns.
    S = (X * w[:, None]).T @ Y
    # Step 4: with S = U D V^T, R = V diag(1, 1, det(V U^T)) U^T, which is no reflection.
    U, _, Vt = np.linalg.svd(S)
    V = Vt.T
    sign = 1.0 if np.linalg.det(V @ U.T) >= 0 else -1.0
    R = V @ np.diag([1.0, 1.0, sign]) @ U.T
    # Step 5: the translation.
    return rigid_transform(R, q_mean - R @ p_mean)


def rotation_angle_rad(R: Array) -> float:
    """Return the angle of a 3x3 rotation, 0 to pi.

    Exact near zero, unlike the arc cosine of the trace.
    """
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1.0))


def pose_distance(T: Array, other: Array) -> tuple[float, float]:
    """Return the length (meters) and the angle (radians) of the motion between two 4x4 poses."""
    motion = inverse(T) @ other
    return float(np.linalg.norm(motion[:3, 3])), rotation_angle_rad(motion[:3, :3])


def poses_close(T: Array, other: Array, max_distance_m: float, max_angle_rad: float) -> bool:
    """Whether two 4x4 poses differ by at most a distance and an angle."""
    distance_m, angle_rad = pose_distance(T, other)
    return bool(distance_m <= max_distance_m and angle_rad <= max_angle_rad)


def skew_matrix(v: ArrayLike) -> Array:
    """Make the 3x3 matrix with ``skew_matrix(v) @ w == cross(v, w)``."""
    x, y, z = np.asarray(v, dtype=np.float64).tolist()  # NumPy's scalars are slow
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def adjoint(T: Array) -> Array:
    """Return the 6x6 adjoint of a rigid transform, with twists as (translation, rotation)."""
    R = T[:3, :3]
    Ad = np.zeros((6, 6))
    Ad[:3, :3] = Ad[3:, 3:] = R
    Ad[:3, 3:] = skew_matrix(T[:3, 3]) @ R
    return Ad


def transport_covariance(covariance: Array, T_reference_camera: Array) -> Array:
    """Transport a motion's covariance (..., 6, 6) from the reference's axes to the camera's."""
    Ad = adjoint(inverse(T_reference_camera))
    return Ad @ covariance @ Ad.T


def rotation_from_quaternion(quaternion_xyzw: ArrayLike) -> Array:
    """Convert a quaternion (x y z w) of any non-zero length to a 3x3 rotation.

    Raises:
        ValueError: The quaternion is zero or not finite.
    """
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    largest = np.max(np.abs(q))
    if not 0.0 < largest < np.inf:
        raise ValueError(f"not a rotation: quaternion {q.tolist()} is zero or not finite")
    q = q / largest  # so that no square overflows or vanishes
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_rotation(R: Array) -> Array:
    """Convert a 3x3 rotation to a unit quaternion (x y z w) with w >= 0.

    It is an eigenvector of Bar-Itzhack's symmetric 4x4 matrix: no branch, stable for every angle.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R.tolist()  # NumPy's scalars are slow
    K = np.array(
        [
            [xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, yy - xx - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, zz - xx - yy, yx - xy],
            [zy - yz, xz - zx, yx - xy, xx + yy + zz],
        ]
    )
    q: Array = np.linalg.eigh(K)[1][:, 3]
    return -q if q[3] < 0 else q


def _length(vector: Array) -> float:
    """Length of a short vector: `np.linalg.norm` takes twice as long for the same bits."""
    contiguous = vector.ravel()
    return math.sqrt(contiguous.dot(contiguous))


def so3_exp(rotation_vector_rad: ArrayLike) -> Array:
    """Convert a rotation vector (3,) in radians to a 3x3 rotation, by Rodrigues' formula."""
    v = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = _length(v)
    K = skew_matrix(v)
    # np.sinc(x) is sin(pi x) / (pi x): both factors stay exact down to a zero angle.
    sine, half_sine = np.sinc([angle / np.pi, angle / (2 * np.pi)])
    return np.eye(3) + sine * K + 0.5 * half_sine**2 * (K @ K)


def so3_log(R: Array) -> Array:
    """Convert a 3x3 rotation to a rotation vector (3,) in radians: the inverse of `so3_exp`."""
    q = quaternion_from_rotation(R)
    sine = _length(q[:3])
    half_angle = float(np.arctan2(sine, q[3]))
    scale = 2.0 if sine < 1e-12 else 2.0 * half_angle / sine
    return scale * q[:3]


def transform_from_pose(position_m: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """Make a 4x4 transform from a position (3,) in meters and a quaternion (x y z w)."""
    return rigid_transform(rotation_from_quaternion(quaternion_xyzw), position_m)


def is_rigid(T: NDArray[Any], tolerance: float = 1e-6) -> bool:
    """Whether T is a finite 4x4 rigid transform with a proper rotation."""
    if T.shape != (4, 4) or not np.all(np.isfinite(T)):
        return False
    R = T[:3, :3]
    if np.max(np.abs(R)) > 1.0 + tolerance:  # its square may overflow
        return False
    orthonormal = np.allclose(R @ R.T, np.eye(3), rtol=0.0, atol=tolerance)
    return bool(orthonormal and np.linalg.det(R) > 0 and np.array_equal(T[3], [0, 0, 0, 1]))


# The default mounting: the base has the camera's position, in REP 103 axes.
T_BODY_CAMERA = rigid_transform(R_BODY_OPTICAL, np.zeros(3))


Vector = tuple[float, float, float]


def is_gravity(vector_m_s2: Vector) -> bool:
    """Whether the vector's length is within 10 % of gravity; else the camera accelerates."""
    error = abs(math.hypot(*vector_m_s2) / STANDARD_GRAVITY_M_S2 - 1.0)
    return error <= MAX_LENGTH_ERROR


def gravity_from_accelerometer(acceleration_m_s2: Vector) -> Vector:
    """Convert a reading of a Kinect's accelerometer to gravity in camera axes.

    The accelerometer is in the head, beside the cameras, so the tilt angle is irrelevant. It
    measures the reaction to gravity on x left, y up, z forward: (0, 9.81, 0) when level.
    Microsoft's SDK documents these axes and an accuracy of about three degrees. libfreenect and
    the accelerometer.txt of the TUM benchmark have these signs; in freiburg1_desk they agree with
    the motion capture in all three axes.
    """
    x_left, y_up, z_forward = acceleration_m_s2
    return (x_left, y_up, -z_forward)


def accelerometer_from_gravity(gravity_m_s2: Vector) -> Vector:
    """Invert `gravity_from_accelerometer`."""
    x_right, y_down, z_forward = gravity_m_s2
    return (x_right, y_down, -z_forward)


COLUMNS = "stamp tx ty tz qx qy qz qw"
# Larger values mean that a file is in other units, such as nanoseconds.
MAX_STAMP_S = 1e11
MAX_POSITION_M = 1e9
# Files round the numbers of a quaternion.
MAX_QUATERNION_ERROR = 0.01
# The largest difference of two stamps of the same instant.
MAX_STAMP_DIFFERENCE_S = 0.020


# Of a pose that counts as that of a frame.
MAX_POSE_GAP_S = 0.02


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

    def pose_near(self, stamp_s: float) -> Array | None:
        """Return the (4, 4) pose nearest in time; None if that is too far away."""
        gaps_s = np.abs(self.stamps_s - stamp_s)
        nearest = int(np.argmin(gaps_s))
        return self.T_world_camera[nearest] if gaps_s[nearest] <= MAX_POSE_GAP_S else None


def read_trajectory(path: Path) -> Trajectory:
    """Read a TUM-format file; blank lines and ``#`` comments are skipped.

    Raises:
        InputError: The file cannot be read or parsed, holds NaN, a quaternion that is no rotation
            or values in other units, or its stamps do not rise. The message names file and line.
    """
    rows = read_trajectory_rows(path)
    return make_trajectory([(where, *parse_pose(words, where)) for where, words in rows])


def read_trajectory_rows(path: Path) -> list[tuple[str, list[str]]]:
    """Read FILE:LINE and the columns, at spaces or commas, of each line with a pose.

    Raises:
        InputError: The file cannot be read, or holds none.
    """
    lines = read_input_text(path, f"give a text file with lines of: {COLUMNS}").splitlines()
    columns = [line.split("#", 1)[0].replace(",", " ").split() for line in lines]
    rows = [(f"{path}:{number}", words) for number, words in enumerate(columns, 1) if words]
    if not rows:
        raise InputError(f"{path}: holds no pose; expected lines of: {COLUMNS}")
    return rows


def make_trajectory(poses: Sequence[tuple[str, float, Array]]) -> Trajectory:
    """Make a trajectory of (FILE:LINE, stamp, 4x4 pose).

    Raises:
        InputError: The stamps do not rise.
    """
    for (_, before_s, _), (where, stamp_s, _) in pairwise(poses):
        if stamp_s <= before_s:
            raise InputError(
                f"{where}: stamp {stamp_s!r} is not after the previous one ({before_s:.6f}): "
                "sort the file by its first column and remove duplicates"
            )
    return Trajectory(np.array([s for _, s, _ in poses]), np.array([T for *_, T in poses]))


def format_pose_line(stamp_s: float, T_world_camera: Array) -> str:
    """Format one line of a trajectory file, with its newline.

    The resolution is 1 us of the stamp, 0.1 um of the position and 1e-9 of the quaternion.
    """
    q = quaternion_from_rotation(T_world_camera[:3, :3])
    position = " ".join(f"{v:.7f}" for v in T_world_camera[:3, 3])
    return f"{stamp_s:.6f} {position} {' '.join(f'{v:.9f}' for v in q)}\n"


def format_trajectory(trajectory: Trajectory, offset_s: float = 0.0) -> bytes:
    """Format a trajectory file; `offset_s` is added to the stamps."""
    stamps_s = trajectory.stamps_s + offset_s
    return "".join(map(format_pose_line, stamps_s, trajectory.T_world_camera)).encode()


def parse_pose(text: Sequence[str], where: str) -> tuple[float, Array]:
    """Parse stamp, position and quaternion. Raises InputError with the place `where`."""
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
    length = math.hypot(*values[4:8])
    if abs(length - 1.0) > MAX_QUATERNION_ERROR:
        raise InputError(
            f"{where}: not a rotation: the quaternion has length {length:.4g}, not 1; expected: "
            f"{COLUMNS}"
        )
    return values[0], transform_from_pose(values[1:4], values[4:8])


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

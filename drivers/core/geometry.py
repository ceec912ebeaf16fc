"""Rigid transforms and quaternions: the one place where they are converted.

A rigid transform is a 4x4 float64 matrix. ``T_a_b`` maps coordinates in frame b to frame a,
so ``T_a_c = T_a_b @ T_b_c``. Quaternions are x y z w everywhere.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def rigid_transform(rotation: ArrayLike, translation_m: ArrayLike) -> Array:
    """4x4 transform from a 3x3 rotation and a translation of 3 metres."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation_m
    return T


def inverse(T: Array) -> Array:
    """Inverse of a rigid 4x4 transform."""
    R, t = T[:3, :3], T[:3, 3]
    return rigid_transform(R.T, -R.T @ t)


def orthonormalize(T: Array) -> Array:
    """The same rigid 4x4 transform without the rounding of its many products.

    Whoever inverts by transposing and multiplies again must use it: the rounding grows with each
    round, at first unseen. Two steps of Newton's iteration towards the nearest rotation (Higham,
    "Computing the Polar Decomposition", 1986); what is left over is the fourth power.
    """
    R = T[:3, :3]
    for _ in range(2):
        R = 0.5 * R @ (3.0 * np.eye(3) - R.T @ R)
    return rigid_transform(R, T[:3, 3])


def transform_points(T: Array, points: Array) -> Array:
    """Map (N, 3) points through a 4x4 transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def rotation_angle_rad(R: Array) -> float:
    """Angle of a 3x3 rotation, 0 to pi. Exact near zero, unlike the arc cosine of the trace."""
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    return float(np.arctan2(np.linalg.norm(axis), np.trace(R) - 1.0))


def pose_distance(T: Array, other: Array) -> tuple[float, float]:
    """Metres and radians between two rigid 4x4 transforms: of the motion from one to the other."""
    motion = inverse(T) @ other
    return float(np.linalg.norm(motion[:3, 3])), rotation_angle_rad(motion[:3, :3])


def poses_close(T: Array, other: Array, max_distance_m: float, max_angle_rad: float) -> bool:
    """Whether two rigid 4x4 transforms are no further apart than this, by way and by turn."""
    way_m, turn_rad = pose_distance(T, other)
    return bool(way_m <= max_distance_m and turn_rad <= max_angle_rad)


def skew_matrix(v: ArrayLike) -> Array:
    """3x3 matrix with ``skew_matrix(v) @ w == cross(v, w)``."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def adjoint(T: Array) -> Array:
    """6x6 adjoint of a rigid transform, twists as (translation, rotation)."""
    R = T[:3, :3]
    Ad = np.zeros((6, 6))
    Ad[:3, :3] = Ad[3:, 3:] = R
    Ad[:3, 3:] = skew_matrix(T[:3, 3]) @ R
    return Ad


def transport_covariance(covariance: Array, T_reference_camera: Array) -> Array:
    """Covariance (..., 6, 6) of a small motion in the reference's axes, as one in the camera's."""
    Ad = adjoint(inverse(T_reference_camera))
    in_camera: Array = Ad @ covariance @ Ad.T
    return in_camera


def rotation_from_quaternion(quaternion_xyzw: ArrayLike) -> Array:
    """3x3 rotation from a quaternion (x y z w) of any non-zero length.

    Raises ValueError if the quaternion is zero or not finite.
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
    """Unit quaternion (x y z w), w >= 0, of a 3x3 rotation.

    The eigenvector of Bar-Itzhack's symmetric 4x4 matrix: no branch, stable for every angle.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = R
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


def so3_exp(rotation_vector_rad: ArrayLike) -> Array:
    """Rodrigues' formula: 3x3 rotation about the vector by its length."""
    v = np.asarray(rotation_vector_rad, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    K = skew_matrix(v)
    # np.sinc(x) is sin(pi x) / (pi x): both factors stay exact down to a zero angle.
    sine = np.sinc(angle / np.pi)
    cosine = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.eye(3) + sine * K + cosine * (K @ K)


def so3_log(R: Array) -> Array:
    """Axis times angle (3,), radians, of a 3x3 rotation: inverse of `so3_exp`."""
    q = quaternion_from_rotation(R)
    sine = float(np.linalg.norm(q[:3]))
    half_angle = float(np.arctan2(sine, q[3]))
    scale = 2.0 if sine < 1e-12 else 2.0 * half_angle / sine
    vector: Array = scale * q[:3]
    return vector


def transform_from_pose(position_m: ArrayLike, quaternion_xyzw: ArrayLike) -> Array:
    """4x4 transform from a position and a quaternion (x y z w)."""
    return rigid_transform(rotation_from_quaternion(quaternion_xyzw), position_m)


def is_rigid(T: NDArray[Any], tolerance: float = 1e-6) -> bool:
    """True if T is a finite 4x4 rigid transform with a proper rotation."""
    if T.shape != (4, 4) or not np.all(np.isfinite(T)):
        return False
    R = T[:3, :3]
    if np.max(np.abs(R)) > 1.0 + tolerance:  # its square may overflow
        return False
    orthonormal = np.allclose(R @ R.T, np.eye(3), rtol=0.0, atol=tolerance)
    return bool(orthonormal and np.linalg.det(R) > 0 and np.array_equal(T[3], [0, 0, 0, 1]))


# Optical axes (x right, y down, z forward) in REP 103's (x forward, y left, z up).
R_BODY_OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
# The base that a camera without a mounting has: its own body.
T_BODY_CAMERA = rigid_transform(R_BODY_OPTICAL, np.zeros(3))

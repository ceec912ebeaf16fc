"""Batched rigid transforms (..., 4, 4), as `drivers.core.geometry` has them for single ones."""

import numpy as np

from drivers.core.geometry import Array


def invert_poses(T: Array) -> Array:
    """Inverses of rigid transforms (..., 4, 4)."""
    transposed = np.swapaxes(T[..., :3, :3], -1, -2)
    result = np.zeros_like(T)
    result[..., :3, :3] = transposed
    result[..., :3, 3] = -(transposed @ T[..., :3, 3, None])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def skew_matrices(v: Array) -> Array:
    """(..., 3, 3) matrices of the cross products with vectors (..., 3)."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    rows = [zero, -z, y, z, zero, -x, -y, x, zero]
    return np.stack(rows, axis=-1).reshape(*v.shape[:-1], 3, 3)


def so3_exp_batch(vectors_rad: Array) -> Array:
    """Rodrigues' formula: (..., 3, 3) rotations about vectors (..., 3) by their lengths."""
    turn = np.linalg.norm(vectors_rad, axis=-1)[..., None, None] / np.pi
    K = skew_matrices(vectors_rad)
    R: Array = np.eye(3) + np.sinc(turn) * K + 0.5 * np.sinc(0.5 * turn) ** 2 * (K @ K)
    return R


def so3_log_batch(R: Array) -> Array:
    """Axis times angle (..., 3), radians, of rotations (..., 3, 3) by less than pi."""
    twice = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    trace = np.trace(R, axis1=-2, axis2=-1)
    angle = np.arctan2(np.linalg.norm(twice, axis=-1), trace - 1.0)
    vectors_rad: Array = 0.5 * twice / np.sinc(angle / np.pi)[..., None]
    return vectors_rad


def retract_poses(T: Array, steps: Array) -> Array:
    """Apply steps (..., 6) to rigid transforms (..., 4, 4) in their own axes.

    A step is (translation m, rotation rad). One Newton iteration keeps the rotations orthonormal.
    """
    R = T[..., :3, :3]
    rotated = R @ so3_exp_batch(steps[..., 3:])
    result = T.copy()
    result[..., :3, :3] = 0.5 * rotated @ (3.0 * np.eye(3) - np.swapaxes(rotated, -1, -2) @ rotated)
    result[..., :3, 3] += (R @ steps[..., :3, None])[..., 0]
    return result

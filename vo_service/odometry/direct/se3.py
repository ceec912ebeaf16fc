"""Rigid transforms in kernels, with the exponential and the logarithm of SE(3).

A twist is (translation m, rotation rad), the coordinates of a motion at constant velocity; over a
second it is that velocity. Sola, Deray and Atchuthan, "A micro Lie theory for state estimation in
robotics" (2018), Appendix D.
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel

# Below this angle series are used: their next term is below double precision.
SMALL_ANGLE_RAD = 1e-3


@kernel
def se3_exp(twist: Array) -> Array:
    """4x4 rigid transform of a twist (6,)."""
    x, y, z = twist[3], twist[4], twist[5]
    squared = x * x + y * y + z * z
    angle = np.sqrt(squared)
    if angle < SMALL_ANGLE_RAD:
        sine, cosine, rest = 1 - squared / 6, 0.5 - squared / 24, 1 / 6 - squared / 120
    else:
        sine = np.sin(angle) / angle
        cosine = (1 - np.cos(angle)) / squared
        rest = (1 - sine) / squared
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    KK = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            KK[i, j] = twist[3 + i] * twist[3 + j] - (squared if i == j else 0.0)
    T = np.eye(4)
    for i in range(3):
        for j in range(3):
            T[i, j] += sine * K[i, j] + cosine * KK[i, j]
            along = (1.0 if i == j else 0.0) + cosine * K[i, j] + rest * KK[i, j]
            T[i, 3] += along * twist[j]
    return T


@inline_kernel
def transform_point(T: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Transform a point by a rigid transform 4x4."""
    return (
        T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3],
        T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3],
        T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3],
    )


@kernel
def compose(A: Array, B: Array) -> Array:
    """Product A B of two rigid transforms 4x4."""
    T = np.eye(4)
    for i in range(3):
        for j in range(4):
            T[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
        T[i, 3] += A[i, 3]
    return T


@kernel
def se3_log(T: Array) -> Array:
    """Twist (6,) of a rigid transform 4x4 with an angle below pi."""
    twist = np.empty(6)
    x, y, z = 0.5 * (T[2, 1] - T[1, 2]), 0.5 * (T[0, 2] - T[2, 0]), 0.5 * (T[1, 0] - T[0, 1])
    sine = np.sqrt(x * x + y * y + z * z)
    angle = np.arctan2(sine, 0.5 * (T[0, 0] + T[1, 1] + T[2, 2] - 1))
    squared = angle * angle
    if angle < SMALL_ANGLE_RAD:
        scale, rest = 1 + squared / 6, 1 / 12 + squared / 720
    else:
        scale = angle / sine
        rest = (1 - 0.5 * angle * np.sin(angle) / (1 - np.cos(angle))) / squared
    x, y, z = scale * x, scale * y, scale * z
    twist[3], twist[4], twist[5] = x, y, z
    # t - w x t / 2 + rest * w x (w x t)
    tx, ty, tz = T[0, 3], T[1, 3], T[2, 3]
    cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
    twist[0] = tx - 0.5 * cx + rest * (y * cz - z * cy)
    twist[1] = ty - 0.5 * cy + rest * (z * cx - x * cz)
    twist[2] = tz - 0.5 * cz + rest * (x * cy - y * cx)
    return twist

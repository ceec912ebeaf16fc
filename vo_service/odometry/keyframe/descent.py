"""Gauss-Newton on one level: the motion that lays a keyframe on a frame, and its movement."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.movement import ACCELERATION, COLUMNS, body_movement
from vo_service.odometry.keyframe.parameters import VELOCITY_SIGMA
from vo_service.odometry.keyframe.readings import read_points
from vo_service.odometry.keyframe.regions import weigh_regions
from vo_service.odometry.keyframe.system import fit_light, sum_bands, with_times
from vo_service.odometry.keyframe.twists import exponential, logarithm, product

# The spreads are found with the first step, in so many sweeps; then once a step.
FIRST_SWEEPS = 3
# Directions that nothing in view settles are left alone: steps along them cost as if they were
# known to what the velocity makes of them in this time.
LOOSE_S = 1.0


@kernel
def descend(
    points: Array,
    grey: NDArray[np.uint8],
    intrinsics: Array,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    falloff: float,
    T_camera_keyframe: Array,
    movement: Array,
    T_keyframe_last: Array,
    rate_hz: float,
    information: Array,
    basic_weights: Array,
    fit: Array,
    steps: int,
    last_step: float,
) -> tuple[Array, Array]:
    """T_camera_keyframe and the movement after some steps.

    movement         (9,) expected, of the motion in the keyframe's axes, see `movement`
    falloff          see `read_points`
    T_keyframe_last  4x4, camera to keyframe, of the frame before
    rate_hz          frames a second since that; 0 ties the velocity to nothing but itself
    information      (9,) how well the movement is known by the way since the frame before
    fit              see `system`; in and out
    last_step        a step as small as this, in m and rad, is the last
    """
    T, expected, movement = T_camera_keyframe.copy(), movement.copy(), movement.copy()
    readings = np.empty((len(points), reading_columns.COLUMNS))
    for step in range(steps):
        read_points(
            points,
            T,
            body_movement(T, movement),
            grey,
            intrinsics,
            inverse_depth,
            depth_intrinsics,
            readout_s,
            skew_s,
            falloff,
            readings,
        )
        cell_weights = weigh_regions(points, readings, fit, basic_weights)
        for _ in range(FIRST_SWEEPS if step == 0 else 1):
            fit_light(points, readings, cell_weights, fit)
        bands = sum_bands(points, readings, cell_weights, fit)
        H, g = with_times(bands, readout_s, skew_s)
        if rate_hz != 0.0:
            expected[:ACCELERATION] = logarithm(product(T_keyframe_last, T)) * rate_hz
        tie_movement(H, g, movement - expected, rate_hz, information)
        hold_loosely(H)
        x = solve(H, g)
        T = product(T, exponential(-x[:6]))
        movement -= x[6:]
        if np.max(np.abs(x[:6])) < last_step:
            break
    return T, movement


@kernel
def hold_loosely(H: Array) -> None:
    """Leave alone what nothing in view settles: see `LOOSE_S`."""
    for i in range(3):
        H[i, i] += 1.0 / (LOOSE_S * VELOCITY_SIGMA[0]) ** 2
        H[3 + i, 3 + i] += 1.0 / (LOOSE_S * VELOCITY_SIGMA[1]) ** 2


@kernel
def tie_movement(H: Array, g: Array, off: Array, rate_hz: float, information: Array) -> None:
    """Add what is known of the movement: its velocity is about the mean since the frame before.

    off  (9,) how far it is from that now
    """
    for i in range(COLUMNS):
        P = information[i]
        H[6 + i, 6 + i] += P
        g[6 + i] += P * off[i]
        if i < ACCELERATION:
            H[6 + i, i] -= P * rate_hz
            H[i, 6 + i] -= P * rate_hz
            H[i, i] += P * rate_hz * rate_hz
            g[i] -= P * rate_hz * off[i]


@kernel
def solve(A: Array, b: Array) -> Array:
    """Solve A x = b by Cholesky's factors; A is symmetric and positive definite."""
    n = len(b)
    L = np.zeros((n, n))
    x = b.copy()
    for j in range(n):
        for i in range(j, n):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(total, 1e-12)) if i == j else total / L[j, j]
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]
    return x

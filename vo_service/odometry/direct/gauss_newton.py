"""Gauss-Newton on one level: the motion that lays a keyframe on a frame, and its movement."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct import warping as reading_columns
from vo_service.odometry.direct.normal_equations import (
    accumulate,
    expand_rolling_shutter,
    fit_affine_brightness,
)
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.region_weights import weigh_regions
from vo_service.odometry.direct.rolling_shutter import ACCELERATION_START, MOTION_SIZE, body_motion
from vo_service.odometry.direct.se3 import compose, se3_exp, se3_log
from vo_service.odometry.direct.warping import warp_and_sample

# The spreads are found with the first step, in so many sweeps; then once a step.
INITIAL_SWEEPS = 3
# Directions that nothing in view settles are left alone: steps along them cost as if they were
# known to what the velocity makes of them in this time.
DAMPING_SPAN_S = 1.0


@kernel
def solve_level(
    points: Array,
    gray: NDArray[np.uint8],
    intrinsics: Array,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    vignetting: float,
    T_camera_keyframe: Array,
    motion: Array,
    T_keyframe_last: Array,
    rate_hz: float,
    prior_information: Array,
    base_weights: Array,
    residual_model: Array,
    max_steps: int,
    min_step_size: float,
) -> tuple[Array, Array]:
    """T_camera_keyframe and the movement after some steps.

    movement         (9,) expected, of the motion in the keyframe's axes, see `movement`
    falloff          see `warp_and_sample`
    T_keyframe_last  4x4, camera to keyframe, of the frame before
    rate_hz          frames a second since that; 0 ties the velocity to nothing but itself
    information      (9,) how well the movement is known by the way since the frame before
    fit              see `system`; in and out
    last_step        a step as small as this, in m and rad, is the last
    """
    T, expected, motion = T_camera_keyframe.copy(), motion.copy(), motion.copy()
    readings = np.empty((len(points), reading_columns.NUM_SAMPLE_COLUMNS))
    for step in range(max_steps):
        warp_and_sample(
            points,
            T,
            body_motion(T, motion),
            gray,
            intrinsics,
            inverse_depth,
            depth_intrinsics,
            readout_s,
            skew_s,
            vignetting,
            readings,
        )
        cell_weights = weigh_regions(points, readings, residual_model, base_weights)
        for _ in range(INITIAL_SWEEPS if step == 0 else 1):
            fit_affine_brightness(points, readings, cell_weights, residual_model)
        bands = accumulate(points, readings, cell_weights, residual_model)
        H, g = expand_rolling_shutter(bands, readout_s, skew_s)
        if rate_hz != 0.0:
            expected[:ACCELERATION_START] = se3_log(compose(T_keyframe_last, T)) * rate_hz
        add_motion_prior(H, g, motion - expected, rate_hz, prior_information)
        add_damping(H)
        x = solve_cholesky(H, g)
        T = compose(T, se3_exp(-x[:6]))
        motion -= x[6:]
        if np.max(np.abs(x[:6])) < min_step_size:
            break
    return T, motion


@kernel
def add_damping(H: Array) -> None:
    """Leave alone what nothing in view settles: see `DAMPING_SPAN_S`."""
    for i in range(3):
        H[i, i] += 1.0 / (DAMPING_SPAN_S * VELOCITY_SIGMA[0]) ** 2
        H[3 + i, 3 + i] += 1.0 / (DAMPING_SPAN_S * VELOCITY_SIGMA[1]) ** 2


@kernel
def add_motion_prior(
    H: Array, g: Array, motion_error: Array, rate_hz: float, prior_information: Array
) -> None:
    """Add what is known of the movement: its velocity is about the mean since the frame before.

    off  (9,) how far it is from that now
    """
    for i in range(MOTION_SIZE):
        P = prior_information[i]
        H[6 + i, 6 + i] += P
        g[6 + i] += P * motion_error[i]
        if i < ACCELERATION_START:
            H[6 + i, i] -= P * rate_hz
            H[i, 6 + i] -= P * rate_hz
            H[i, i] += P * rate_hz * rate_hz
            g[i] -= P * rate_hz * motion_error[i]


@kernel
def solve_cholesky(A: Array, b: Array) -> Array:
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

"""Gauss-Newton on one level: the pose that aligns a keyframe with a frame, and the motion."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.normal_equations import (
    accumulate,
    expand_rolling_shutter,
    fit_affine_brightness,
)
from vo_service.odometry.direct.parameters import DAMPING_SIGMAS, INITIAL_MODEL_UPDATES
from vo_service.odometry.direct.region_weights import weigh_regions
from vo_service.odometry.direct.rolling_shutter import ACCELERATION_START, MOTION_SIZE, body_motion
from vo_service.odometry.direct.se3 import compose, se3_exp, se3_log
from vo_service.odometry.direct.warping import NUM_SAMPLE_COLUMNS, warp_and_sample


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
    """Refine T_camera_keyframe and the motion on one level.

    Args:
        points: (N, COLUMNS) of the level.
        gray: (h, w) of the level.
        intrinsics: (4,) of the level.
        inverse_depth: (H, W), 1/m; 0 = no reading.
        depth_intrinsics: (4,) of the whole size.
        readout_s: Time from the first row to the last.
        skew_s: Time of the depth image after the color image.
        vignetting: See `warp_and_sample`.
        T_camera_keyframe: 4x4 initial guess.
        motion: (9,) expected, of the keyframe's points in the keyframe's axes.
        T_keyframe_last: 4x4, camera to keyframe, of the last frame.
        rate_hz: 1 / the time since that frame; with 0 it does not constrain the velocity.
        prior_information: (9,) of the motion.
        base_weights: (2, CELLS) before the weights of the regions.
        residual_model: (4,), in and out, see `normal_equations`.
        max_steps: Largest number of steps.
        min_step_size: A smaller step, in m and rad, is the last one.

    Returns:
        T_camera_keyframe 4x4 and the motion (9,).
    """
    T, expected, motion = T_camera_keyframe.copy(), motion.copy(), motion.copy()
    samples = np.empty((len(points), NUM_SAMPLE_COLUMNS))
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
            samples,
        )
        cell_weights = weigh_regions(points, samples, residual_model, base_weights)
        for _ in range(INITIAL_MODEL_UPDATES if step == 0 else 1):
            fit_affine_brightness(points, samples, cell_weights, residual_model)
        bands = accumulate(points, samples, cell_weights, residual_model)
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
    """Damp unconstrained directions, by `DAMPING_SIGMAS`; H (15, 15) in place."""
    for i in range(3):
        H[i, i] += 1.0 / DAMPING_SIGMAS[0] ** 2
        H[3 + i, 3 + i] += 1.0 / DAMPING_SIGMAS[1] ** 2


@kernel
def add_motion_prior(
    H: Array, g: Array, motion_error: Array, rate_hz: float, prior_information: Array
) -> None:
    """Add the prior: the velocity is about the mean since the last frame.

    Args:
        H: (15, 15), in and out.
        g: (15,), in and out.
        motion_error: (9,) difference of the motion from its expected value.
        rate_hz: 1 / the time since the last frame.
        prior_information: (9,) of the motion.
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
    """Solve A x = b by Cholesky factorization; A is symmetric and positive definite."""
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

"""Gauss-Newton on one pyramid level: the pose that aligns a keyframe with a frame, and the motion.

With a rolling shutter, the motion during the readout is
solved for as well: Kerl, Stueckler and Cremers, "Dense Continuous-Time Tracking and Mapping with
Rolling Shutter RGB-D Cameras" (ICCV 2015).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.factor import (
    Jacobian,
    brightness_residual,
    jacobian,
    student_weight,
)
from vo_service.odometry.direct.image_pyramid import LevelImages
from vo_service.odometry.direct.motion import (
    ACCELERATION_START,
    MOTION_SIZE,
    NUM_UNKNOWNS,
    body_motion,
    compose,
    invert,
    se3_exp,
    se3_log,
)
from vo_service.odometry.direct.parameters import (
    DAMPING_SIGMAS,
    INITIAL_MODEL_UPDATES,
    TREMOR_SPAN_S,
)
from vo_service.odometry.direct.points import (
    Points,
)
from vo_service.odometry.direct.residuals import (
    ResidualModel,
    WeightedSamples,
    fit_residual_model,
    weigh_regions,
    weigh_samples,
)
from vo_service.odometry.direct.samples import (
    NUM_ROW_BANDS,
    Samples,
    empty_samples,
    warp_and_sample,
)
from vo_service.odometry.direct.small_matrices import solve_cholesky

# Number of elements in the upper triangle of a symmetric 6x6 matrix; sums of the normal equations
# have them row by row, then the 6 elements of the vector.
TRIANGLE_SIZE = 21
NUM_SUMS = TRIANGLE_SIZE + 6
# Indices of the matrix's elements in the triangle.
UPPER_TRIANGLE = np.empty((6, 6), np.intp)
UPPER_TRIANGLE[np.triu_indices(6)] = UPPER_TRIANGLE.T[np.triu_indices(6)] = np.arange(TRIANGLE_SIZE)


IDENTITY, NO_INFORMATION = np.eye(4), np.zeros((6, 6))


class MotionPrior(NamedTuple):
    """Prior of the motion, from the frames before.

    Attributes:
        T_keyframe_last: 4x4, camera to keyframe, of the last frame.
        rate_hz: 1 / the time since that frame; with 0 it does not constrain the velocity.
        motion: (9,) expected, of the keyframe's points in the keyframe's axes, see `motion`.
        information: (9,) of that motion, given the mean velocity since the last frame.
        T_camera_keyframe: 4x4 predicted pose, by wheels or a floor.
        pose_information: 6x6 of it, as a small motion of the keyframe's points in its axes; zero if
            there is no such prediction.
        floor_information: 6x6, the part of it that a floor tells.
    """

    T_keyframe_last: Array
    rate_hz: float
    motion: Array
    information: Array
    T_camera_keyframe: Array = IDENTITY
    pose_information: Array = NO_INFORMATION
    floor_information: Array = NO_INFORMATION


@kernel
def velocity_information(sigma: Array) -> Array:
    """(9,) information of a motion whose velocity has sigma (2,), m/s and rad/s."""
    information = np.empty(MOTION_SIZE)
    for k in range(3):
        information[k] = 1.0 / sigma[0] ** 2
        information[3 + k] = 1.0 / sigma[1] ** 2
        information[ACCELERATION_START + k] = information[3 + k] * TREMOR_SPAN_S**2
    return information


class StepLimits(NamedTuple):
    """When the steps on a level end.

    Attributes:
        max_steps: Largest number of steps.
        min_step_size: A smaller step, in m and rad, is the last one.
    """

    max_steps: int
    min_step_size: float


@kernel
def solve_level(
    points: Points,
    images: LevelImages,
    T_camera_keyframe: Array,
    motion: Array,
    prior: MotionPrior,
    base_weights: Array,
    residual_model: ResidualModel,
    limits: StepLimits,
) -> tuple[Array, Array, ResidualModel]:
    """Refine T_camera_keyframe and the motion on one level.

    Args:
        points: Of the level.
        images: The frame at the level.
        T_camera_keyframe: 4x4 initial guess.
        motion: (9,) initial guess, of the keyframe's points in the keyframe's axes.
        prior: Prior of the motion.
        base_weights: (2, CELLS) before the weights of the regions.
        residual_model: Initial one.
        limits: When the steps end.

    Returns:
        T_camera_keyframe 4x4, the motion (9,), and the residual model.
    """
    T, expected, motion = T_camera_keyframe.copy(), motion.copy(), motion.copy()
    samples, information_of_prior = empty_samples(len(points.brightness)), prior_information(prior)
    for step in range(limits.max_steps):
        warp_and_sample(points, images, T, body_motion(T, motion), samples)
        cell_weights = weigh_regions(points, samples, residual_model, base_weights)
        weighted = weigh_samples(points, samples, cell_weights)
        for _ in range(INITIAL_MODEL_UPDATES if step == 0 else 1):
            residual_model = fit_residual_model(points, weighted, residual_model)
        bands = accumulate(points, samples, weighted, residual_model)
        H, g = expand_rolling_shutter(bands, images.readout_s, images.skew_s)
        if prior.rate_hz != 0.0:
            since_last = se3_log(compose(prior.T_keyframe_last, T))
            for k in range(ACCELERATION_START):
                expected[k] = since_last[k] * prior.rate_hz
        add_motion_prior(H, g, motion, expected, information_of_prior)
        add_pose_prior(H, g, T, prior)
        add_damping(H)
        x, twist, step_size = solve_cholesky(H, g), np.empty(6), 0.0
        for k in range(6):
            twist[k] = -x[k]
            step_size = max(step_size, abs(x[k]))
        T = compose(T, se3_exp(twist))
        for k in range(MOTION_SIZE):
            motion[k] -= x[6 + k]
        if step_size < limits.min_step_size:
            break
    return T, motion, residual_model


@kernel
def accumulate(
    points: Points, samples: Samples, weighted: WeightedSamples, residual_model: ResidualModel
) -> Array:
    """(2 BANDS, 27) sums over the bands of the color image, then over those of the depth image.

    With r = J d, d a small motion of the keyframe's points as a twist (translation m, rotation rad)
    in the keyframe's axes: the upper triangle of sum w J^T J, row by row, then sum w J^T r. All
    rows of a band get the same time, which saves sums and loses little.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        weighted: The same samples.
        residual_model: Of the frame.
    """
    sums = np.zeros((2 * NUM_ROW_BANDS, NUM_SUMS))
    residuals, weights, depth_weights = student_weights(
        (points.brightness, points.brightness_variance), weighted, residual_model
    )
    _add_residuals(
        points.position_m,
        (points.brightness_gradient, residual_model.gain),
        samples.color_band,
        weights,
        residuals,
        sums[:NUM_ROW_BANDS],
    )
    _add_residuals(
        points.position_m,
        (points.depth_gradient, 1.0),
        samples.depth_band,
        depth_weights,
        weighted.depth,
        sums[NUM_ROW_BANDS:],
    )
    return sums


@kernel
def _add_residuals(
    position_m: Array,
    gradient: tuple[Array, float],
    bands: NDArray[np.int32],
    weights: Array,
    residuals: Array,
    sums: Array,
) -> None:
    """Add the residuals of one image, see `accumulate`.

    Neighbors in one band are added in pairs: loading and storing the sums takes most of the time.

    Args:
        position_m: (3, N) of a keyframe level's points.
        gradient: The gradient (3, N) of its points, and its scale; see `jacobian`.
        bands: (N,) band of each residual.
        weights: (N,); 0 where there is none.
        residuals: (N,).
        sums: (BANDS, 27), in and out.
    """
    by_position, scale = gradient
    used, count = np.empty(len(weights) + 1, np.uint32), 0
    for i in range(len(weights)):
        used[count] = i
        count += weights[i] != 0.0
    # No pair beyond the end: the last residual has no neighbor in its band.
    used[count] = used[count - 1]
    k = 0
    while k < count:
        i, j = used[k], used[k + 1]
        band = np.uint32(bands[i])
        J = jacobian(position_m, by_position, i, scale)
        if j > i and np.uint32(bands[j]) == band:
            next_J = jacobian(position_m, by_position, j, scale)
            _add_pair(
                sums[band], (J, next_J), (weights[i], weights[j]), (residuals[i], residuals[j])
            )
            k += 2
        else:
            _add_to_sums(sums[band], J, weights[i], residuals[i])
            k += 1


@kernel
def student_weights(
    of_points: tuple[Array, Array], weighted: WeightedSamples, residual_model: ResidualModel
) -> tuple[Array, Array, Array]:
    """Residuals (N,) of brightness, and weights (N,) of brightness and of depth.

    The weights are 0 where there is no sample.

    Args:
        of_points: (N,) brightness of points, and its variance.
        weighted: The samples of these points in a frame.
        residual_model: Of the frame.
    """
    keyframe_brightness, point_variance = of_points
    count = len(keyframe_brightness)
    residuals, weights, depth_weights = np.empty(count), np.empty(count), np.empty(count)
    brightness, brightness_weight, depth, depth_weight = weighted
    gain = residual_model.gain
    weight_of_brightness = residual_model.brightness_weight
    variance = residual_model.sigma_brightness**2
    variance_depth = residual_model.sigma_depth**2
    for i in range(count):
        residual = brightness_residual(brightness[i], keyframe_brightness[i], gain)
        residuals[i] = residual
        w = student_weight(residual, variance + point_variance[i])
        weights[i] = w * (weight_of_brightness * brightness_weight[i])
        depth_weights[i] = student_weight(depth[i], variance_depth) * depth_weight[i]
    return residuals, weights, depth_weights


@inline_kernel
def _add_to_sums(sums: Array, J: Jacobian, w: float, residual: float) -> None:
    """Add the upper triangle of w J J^T, row by row, then w J r."""
    k = 0
    for i in range(6):
        weighted = w * J[i]
        for j in range(i, 6):
            sums[k] += weighted * J[j]
            k += 1
        sums[TRIANGLE_SIZE + i] += weighted * residual


@inline_kernel
def _add_pair(
    sums: Array,
    jacobians: tuple[Jacobian, Jacobian],
    weights: tuple[float, float],
    residuals: tuple[float, float],
) -> None:
    """Add two residuals, in this order, as `_add_to_sums` does."""
    first, second = jacobians
    k = 0
    for i in range(6):
        weighted, next_weighted = weights[0] * first[i], weights[1] * second[i]
        for j in range(i, 6):
            sums[k] = (sums[k] + weighted * first[j]) + next_weighted * second[j]
            k += 1
        total = sums[TRIANGLE_SIZE + i] + weighted * residuals[0]
        sums[TRIANGLE_SIZE + i] = total + next_weighted * residuals[1]


@kernel
def band_times(readout_s: float, skew_s: float) -> Array:
    """(2 BANDS,) time of each band's middle row after the frame's stamp, s."""
    times = np.empty(2 * NUM_ROW_BANDS)
    for n in range(NUM_ROW_BANDS):
        times[n] = ((n + 0.5) / NUM_ROW_BANDS - 0.5) * readout_s
        times[NUM_ROW_BANDS + n] = times[n] + skew_s
    return times


@kernel
def expand_rolling_shutter(sums: Array, readout_s: float, skew_s: float) -> tuple[Array, Array]:
    """Information (15, 15) and vector (15,) of the pose and of the motion (9,).

    With r = J (d + tau e + tau^2 f / 2), e and f small changes of the velocity and of the angular
    acceleration (this with J's rotation only), and tau the time of the sample: J' = [J, tau J,
    tau^2 J / 2], and sum w J'^T J' and sum w J'^T r.

    Args:
        sums: (2 BANDS, 27), see `accumulate`.
        readout_s: Time from the first row to the last.
        skew_s: Time of the depth image after the color image.
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    times = band_times(readout_s, skew_s)
    band_information = np.empty((6, 6))
    for n in range(2 * NUM_ROW_BANDS):
        tau = times[n]
        half = 0.5 * tau * tau
        k = 0
        for i in range(6):
            for j in range(i, 6):
                band_information[i, j] = band_information[j, i] = sums[n, k]
                k += 1
        for i in range(6):
            for j in range(6):
                value = band_information[i, j]
                H[i, j] += value
                H[i, 6 + j] += tau * value
                H[6 + i, 6 + j] += tau * tau * value
                if j >= 3:
                    H[i, 9 + j] += half * value
                    H[6 + i, 9 + j] += tau * half * value
                    if i >= 3:
                        H[9 + i, 9 + j] += half * half * value
            r = sums[n, TRIANGLE_SIZE + i]
            g[i] += r
            g[6 + i] += tau * r
            if i >= 3:
                g[9 + i] += half * r
    for i in range(NUM_UNKNOWNS):
        for j in range(i):
            H[i, j] = H[j, i]
    return H, g


@kernel
def add_damping(H: Array) -> None:
    """Damp unconstrained directions, by `DAMPING_SIGMAS`; H (15, 15) in place."""
    for i in range(3):
        H[i, i] += 1.0 / DAMPING_SIGMAS[0] ** 2
        H[3 + i, 3 + i] += 1.0 / DAMPING_SIGMAS[1] ** 2


@kernel
def prior_information(prior: MotionPrior) -> Array:
    """(15, 15) information of the prior: the velocity is about the mean since the last frame.

    It couples pose and motion, as a change of the pose changes that mean.
    """
    information, rate_hz = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), prior.rate_hz
    for k in range(MOTION_SIZE):
        P = prior.information[k]
        information[6 + k, 6 + k] = P
        if k < ACCELERATION_START:
            information[k, k] = rate_hz**2 * P
            information[k, 6 + k] = information[6 + k, k] = -rate_hz * P
    return information


@kernel
def add_motion_prior(
    H: Array, g: Array, motion: Array, expected: Array, information: Array
) -> None:
    """Add the prior.

    Args:
        H: (15, 15), in and out.
        g: (15,), in and out.
        motion: (9,).
        expected: (9,) motion.
        information: (15, 15), see `prior_information`.
    """
    for i in range(NUM_UNKNOWNS):
        for j in range(NUM_UNKNOWNS):
            H[i, j] += information[i, j]
        for j in range(MOTION_SIZE):
            g[i] += information[i, 6 + j] * (motion[j] - expected[j])


@kernel
def add_pose_prior(H: Array, g: Array, T: Array, prior: MotionPrior) -> None:
    """Add the prediction by wheels or a floor.

    Args:
        H: (15, 15), in and out.
        g: (15,), in and out.
        T: 4x4 T_camera_keyframe.
        prior: With the prediction.
    """
    trace = 0.0
    for i in range(6):
        trace += prior.pose_information[i, i]
    if trace == 0.0:
        return
    error = se3_log(compose(invert(prior.T_camera_keyframe), T))
    for i in range(6):
        for j in range(6):
            H[i, j] += prior.pose_information[i, j]
            g[i] += prior.pose_information[i, j] * error[j]

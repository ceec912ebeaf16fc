"""Covariance of an alignment, and the directions of motion that it constrains.

Neighboring samples share errors: of the keyframe's depth, of interpolation, of calibration. The
scatter of the scores of the image's cells shows how much: the "sandwich" estimator for clustered
observations (Liang and Zeger, Biometrika 73, 1986). The weight of brightness follows from it too.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.alignment import DirectAlignment, PointPyramid
from vo_service.odometry.direct.factor import Jacobian, jacobian
from vo_service.odometry.direct.gauss_newton import (
    TRIANGLE_SIZE,
    UPPER_TRIANGLE,
    MotionPrior,
    accumulate,
    band_times,
    expand_rolling_shutter,
    prior_information,
    student_weights,
)
from vo_service.odometry.direct.image_pyramid import (
    NUM_CELLS,
    ImagePyramid,
    LevelImages,
)
from vo_service.odometry.direct.motion import (
    MOTION_SIZE,
    NUM_UNKNOWNS,
    se3_adjoint,
)
from vo_service.odometry.direct.parameters import (
    COVARIANCE_INFLATION,
    MIN_PLANE_OBSERVABILITY,
    MIN_POSE_SIGMAS,
    MIN_UNBIASED_OBSERVABILITY,
    MIN_VIEW_OBSERVABILITY,
    SLOPE_NOISE,
)
from vo_service.odometry.direct.points import (
    Points,
)
from vo_service.odometry.direct.residuals import (
    ResidualModel,
    WeightedSamples,
    weigh_samples,
)
from vo_service.odometry.direct.samples import NUM_ROW_BANDS, Samples
from vo_service.odometry.direct.small_matrices import (
    add_outer_product,
    invert_information,
    multiply,
    transform_covariance,
)
from vo_service.odometry.uncertainty import (
    DegeneracyAnalysis,
    analyze_degeneracy,
    point_information,
)

AT_REST = np.zeros(MOTION_SIZE)


@dataclass(frozen=True)
class MotionUncertainty:
    """Uncertainty of a motion.

    Attributes:
        covariance: 6x6 of T_keyframe_camera: (translation m, rotation rad), as a small motion in
            the camera's axes.
        degeneracy: Which directions of a small motion of the keyframe's points are constrained.
        shared_error: Ratio by which errors that neighbors share enlarge the scatter of the
            brightness; 0 without brightness.
        is_one_plane: Whether the view shows one plane only, which leaves three directions weak.
        timing_errors: (6, 2) error of the motion, in the covariance's terms, by an error of the
            readout time and of the delay of depth, per second.
    """

    covariance: Array
    degeneracy: DegeneracyAnalysis
    shared_error: float = 0.0
    is_one_plane: bool = False
    timing_errors: Array = field(default_factory=lambda: np.zeros((6, 2)))

    @property
    def observability(self) -> float:
        """Observability of the least constrained direction, see `DegeneracyAnalysis`."""
        return float(self.degeneracy.observability[0])

    @property
    def is_constrained(self) -> NDArray[np.bool_]:
        """(6,) which of the degeneracy's directions the view, or a floor, constrains."""
        is_constrained: NDArray[np.bool_] = self.degeneracy.observability >= (
            MIN_PLANE_OBSERVABILITY if self.is_one_plane else MIN_VIEW_OBSERVABILITY
        )
        return is_constrained

    @property
    def has_biased_error(self) -> bool:
        """Whether a direction is constrained so little that its error has one sign."""
        return self.observability < MIN_UNBIASED_OBSERVABILITY

    @property
    def rejection_reason(self) -> str:
        """Why the motion is rejected though the keyframe fits; "" if it is valid."""
        count = np.count_nonzero(~self.is_constrained)
        if count == 0:
            return ""
        return f"degenerate view: {count} of 6 degrees of freedom are unconstrained"


def estimate_uncertainty(
    points: PointPyramid,
    images: ImagePyramid,
    alignment: DirectAlignment,
    prior: MotionPrior,
    velocity_noise: Array,
    keyframe_motion: Array = AT_REST,
) -> MotionUncertainty:
    """Estimate the uncertainty of an alignment.

    Args:
        points: Of the keyframe for each level.
        images: The frame.
        alignment: The alignment of the frame with the points.
        prior: The prior of its motion.
        velocity_noise: (2,) change of the velocity from frame to frame, m/s and rad/s.
        keyframe_motion: (9,) of the camera that the keyframe was made with, in its own axes.
    """
    covariance, timing_errors, information, moments, shared_error = _analyze_view(
        points[0],
        (alignment.samples, alignment.cell_weights, alignment.residual_model),
        images.levels[0],
        alignment.T_camera_keyframe,
        prior,
        velocity_noise,
        alignment.motion + keyframe_motion,
    )
    noise = point_information(moments)
    degeneracy = analyze_degeneracy(information, noise)
    is_one_plane = bool(degeneracy.observability[2] < MIN_PLANE_OBSERVABILITY)
    if prior.floor_information.any():
        degeneracy = analyze_degeneracy(information + prior.floor_information, noise)
    return MotionUncertainty(covariance, degeneracy, shared_error, is_one_plane, timing_errors)


@kernel
def _analyze_view(
    points: Points,
    alignment: tuple[Samples, Array, ResidualModel],
    images: LevelImages,
    T_camera_keyframe: Array,
    prior: MotionPrior,
    velocity_noise: Array,
    relative_motion: Array,
) -> tuple[Array, Array, Array, Array, float]:
    """Covariance and timing errors in the camera's axes, information, moments, shared error.

    In one kernel, as each call from Python takes time. See its parts for the arguments.

    Args:
        points: Of the keyframe's finest level.
        alignment: The samples, cell weights and residual model of `DirectAlignment`.
        images: The frame at that level.
        T_camera_keyframe: 4x4.
        prior: The prior of the motion.
        velocity_noise: (2,), see `estimate_uncertainty`.
        relative_motion: (9,) of the keyframe's points in its axes: while the frame was taken,
            without that while the keyframe was taken.

    Returns:
        6x6 and (6, 2), see `MotionUncertainty`; 6x6 information of the pose; (4, 4), see
        `accumulate_scores`; see `MotionUncertainty`.
    """
    samples, cell_weights, residual_model = alignment
    readout_s, skew_s = images.readout_s, images.skew_s
    weighted = weigh_samples(points, samples, cell_weights)
    bands = accumulate(points, samples, weighted, residual_model)
    H, _ = expand_rolling_shutter(bands, readout_s, skew_s)
    scores, depth_scores, products, moments = accumulate_scores(
        points, samples, weighted, residual_model, images
    )
    shared_error = _shared_error(scores, products)
    for cell in range(NUM_CELLS):
        for k in range(NUM_UNKNOWNS):
            depth_scores[cell, k] += scores[cell, k]
    in_keyframe = _covariance_in_keyframe(
        H, bands, depth_scores, prior, readout_s, skew_s, velocity_noise
    )
    Ad, information = se3_adjoint(T_camera_keyframe), H[:6, :6].copy()
    timing_errors = multiply(Ad, _timing_errors(bands, information, relative_motion))
    covariance = transform_covariance(Ad, in_keyframe)
    for k in range(6):
        covariance[k, k] += MIN_POSE_SIGMAS[k // 3] ** 2
    return covariance, timing_errors, information, moments, shared_error


@kernel
def _shared_error(scores: Array, products: Array) -> float:
    """Ratio of the scatter of the cells' scores to that of independent samples; 0 without samples.

    Args:
        scores: (CELLS, 15) of brightness.
        products: 6x6 sum of the outer products of the scores of the samples.
    """
    inverse, total, trace = invert_information(products), 0.0, 0.0
    for i in range(6):
        trace += products[i, i]
        for j in range(6):
            for cell in range(len(scores)):
                total += inverse[i, j] * scores[cell, i] * scores[cell, j]
    return total / 6.0 if trace > 0.0 else 0.0


@kernel
def _covariance_in_keyframe(
    H: Array,
    bands: Array,
    scores: Array,
    prior: MotionPrior,
    readout_s: float,
    skew_s: float,
    velocity_noise: Array,
) -> Array:
    """6x6 covariance of a small motion of the keyframe's points, in the keyframe's axes.

    Args:
        H: (15, 15) information of pose and motion.
        bands: (2 BANDS, 27), see `accumulate`.
        scores: (CELLS, 15) of the cells.
        prior: The prior of the motion.
        readout_s: Time from the first row to the last.
        skew_s: Time of the depth image after the color image.
        velocity_noise: (2,), see `estimate_uncertainty`.
    """
    of_prior = prior_information(prior)
    for i in range(6):
        for j in range(6):
            of_prior[i, j] += prior.floor_information[i, j]
    scatter = of_prior.copy()
    for n in range(len(scores)):
        add_outer_product(scatter, scores[n])
    times_s, score = band_times(readout_s, skew_s), np.empty(NUM_UNKNOWNS)
    for n in range(len(bands)):
        for k in range(6):
            score[k] = bands[n, TRIANGLE_SIZE + k]
            score[6 + k] = times_s[n] * score[k]
            if k >= 3:
                score[9 + k] = 0.5 * times_s[n] ** 2 * score[k]
        add_outer_product(scatter, score)
    for i in range(NUM_UNKNOWNS):
        for j in range(NUM_UNKNOWNS):
            of_prior[i, j] += H[i, j]
    joint = transform_covariance(invert_information(of_prior), scatter)
    # The keyframe's rows were corrected by a motion that has the same uncertainty.
    pose_bread = invert_information(H[:6, :6].copy())
    sensitivity = multiply(pose_bread, H[:6, 6:].copy())
    covariance = transform_covariance(sensitivity, joint[6:, 6:].copy())
    noise = _velocity_noise_scatter(bands, readout_s + abs(skew_s), velocity_noise)
    by_noise = transform_covariance(pose_bread, noise)
    for i in range(6):
        for j in range(6):
            total = COVARIANCE_INFLATION * (joint[i, j] + covariance[i, j])
            covariance[i, j] = total + by_noise[i, j]
    return covariance


@kernel
def _velocity_noise_scatter(bands: Array, span_s: float, velocity_noise: Array) -> Array:
    """6x6 scatter of the scores by changes of the velocity during the readout of an image.

    Each band of rows, of the frame and of the keyframe, has a motion error of its own.
    """
    scatter, row = np.zeros((6, 6)), np.empty(6)
    for n in range(len(bands)):
        for j in range(6):
            # Rows are evenly distributed over that time; the error of each grows with its time.
            sigma = span_s * velocity_noise[j // 3] / np.sqrt(12.0)
            for i in range(6):
                row[i] = np.sqrt(2.0) * sigma * bands[n, UPPER_TRIANGLE[i, j]]
            add_outer_product(scatter, row)
    return scatter


@kernel
def _timing_errors(bands: Array, information: Array, relative_motion: Array) -> Array:
    """(6, 2) motion of the keyframe's points by an error of the readout time and of the delay.

    A time that is wrong by dt moves a row's residuals by J v dt, with v the relative motion.
    """
    scores = np.zeros((6, 2))
    for n in range(2 * NUM_ROW_BANDS):
        row = (n % NUM_ROW_BANDS + 0.5) / NUM_ROW_BANDS - 0.5
        for i in range(6):
            for j in range(6):
                score = bands[n, UPPER_TRIANGLE[i, j]] * relative_motion[j]
                scores[i, 0] += row * score
                if n >= NUM_ROW_BANDS:
                    scores[i, 1] += score
    return multiply(invert_information(information), scores)


@kernel
def accumulate_scores(
    points: Points,
    samples: Samples,
    weighted: WeightedSamples,
    residual_model: ResidualModel,
    images: LevelImages,
) -> tuple[Array, Array, Array, Array]:
    """Scores of the cells, the scatter of independent ones, and moments of the points.

    A cell's score is sum w J' r, see `expand_rolling_shutter`. The moments are sum w v^2 q q^T,
    with q the point (x, y, z, 1) and v^2 the variance of its derivative by the slope noise.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        weighted: The same samples.
        residual_model: Of the frame.
        images: The frame at the level.

    Returns:
        (CELLS, 15) scores of brightness and of depth; 6x6 sum of the outer products of the scores
        of the brightness samples, its lower triangle; moments (4, 4).
    """
    scores, moments = np.zeros((NUM_CELLS, NUM_UNKNOWNS)), np.zeros((4, 4))
    depth_scores, products = np.zeros((NUM_CELLS, NUM_UNKNOWNS)), np.zeros((6, 6))
    residuals, weights, depth_weights = student_weights(
        (points.brightness, points.brightness_variance), weighted, residual_model
    )
    gain, depth = residual_model.gain, weighted.depth
    readout_s, skew_s = images.readout_s, images.skew_s
    focal_px, depth_focal_px = images.intrinsics[0], images.depth_intrinsics[0]
    position_m = points.position_m
    for i in range(len(weights)):
        cell = samples.cell[i]
        noise = 0.0
        if weights[i] != 0.0:
            w = weights[i]
            noise += w * (gain * SLOPE_NOISE[0] * focal_px / position_m[2, i]) ** 2
            J = jacobian(position_m, points.brightness_gradient, i, gain)
            row = (samples.color_band[i] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(scores[cell], J, row * readout_s, w * residuals[i])
            for a in range(6):
                for b in range(a + 1):
                    products[a, b] += (w * residuals[i]) ** 2 * J[a] * J[b]
        if depth_weights[i] != 0.0:
            w = depth_weights[i]
            slope_noise = SLOPE_NOISE[1] * images.depth_noise
            noise += w * (slope_noise * depth_focal_px / position_m[2, i]) ** 2
            J = jacobian(position_m, points.depth_gradient, i, 1.0)
            row = (samples.depth_band[i] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(depth_scores[cell], J, row * readout_s + skew_s, w * depth[i])
        if noise > 0.0:
            q = position_m[0, i], position_m[1, i], position_m[2, i], 1.0
            for a in range(4):
                for b in range(4):
                    moments[a, b] += noise * q[a] * q[b]
    return scores, depth_scores, products, moments


@inline_kernel
def _add_score(scores: Array, J: Jacobian, delay_s: float, weighted_residual: float) -> None:
    """Add the score of a sample at a time after the frame's stamp."""
    for k in range(6):
        scores[k] += weighted_residual * J[k]
        scores[6 + k] += delay_s * weighted_residual * J[k]
        if k >= 3:
            scores[9 + k] += 0.5 * delay_s * delay_s * weighted_residual * J[k]

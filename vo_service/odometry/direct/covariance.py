"""Covariance of an alignment, and the directions of motion that it constrains.

Neighboring samples share errors: of the keyframe's depth, of interpolation, of calibration. The
scatter of the scores of the image's cells shows how much: the "sandwich" estimator for clustered
observations (Liang and Zeger, Biometrika 73, 1986).
"""

from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, transport_covariance
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.alignment import DirectAlignment, PointPyramid
from vo_service.odometry.direct.gauss_newton import (
    TRIANGLE_SIZE,
    UPPER_TRIANGLE,
    MotionPrior,
    accumulate,
    band_times,
    expand_rolling_shutter,
    fill_jacobian,
)
from vo_service.odometry.direct.image_pyramid import (
    NUM_CELLS,
    ImagePyramid,
    ImageTiming,
    LevelImages,
)
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
)
from vo_service.odometry.direct.motion import ACCELERATION_START, NUM_UNKNOWNS
from vo_service.odometry.direct.parameters import (
    COVARIANCE_INFLATION,
    MIN_POSE_SIGMAS,
    MIN_VIEW_OBSERVABILITY,
    SLOPE_NOISE,
)
from vo_service.odometry.direct.residuals import (
    GAIN,
    NUM_ROW_BANDS,
    OFFSET,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_COLOR_BAND,
    SAMPLE_DEPTH_BAND,
    SAMPLE_DEPTH_RESIDUAL,
    WEIGHT_BRIGHTNESS,
    residual_variances,
    student_weight,
)
from vo_service.odometry.uncertainty import (
    DegeneracyAnalysis,
    analyze_degeneracy,
    point_information,
)

# Added to the diagonal of an information matrix, relative to its trace, before it is inverted.
REGULARIZATION = 1e-9


@dataclass(frozen=True)
class MotionUncertainty:
    """Uncertainty of a motion.

    Attributes:
        covariance: 6x6 of T_keyframe_camera: (translation m, rotation rad), as a small motion in
            the camera's axes.
        degeneracy: Which directions of a small motion of the keyframe's points are constrained.
    """

    covariance: Array
    degeneracy: DegeneracyAnalysis

    @property
    def observability(self) -> float:
        """Observability of the least constrained direction, see `DegeneracyAnalysis`."""
        return float(self.degeneracy.observability[0])

    @property
    def rejection_reason(self) -> str:
        """Why the motion is rejected though the keyframe fits; "" if it is valid."""
        count = np.count_nonzero(self.degeneracy.observability < MIN_VIEW_OBSERVABILITY)
        if count == 0:
            return ""
        return f"degenerate view: {count} of 6 degrees of freedom are unconstrained"


def estimate_uncertainty(
    points: PointPyramid,
    images: ImagePyramid,
    alignment: DirectAlignment,
    prior: MotionPrior,
    velocity_noise: Array,
) -> MotionUncertainty:
    """Estimate the uncertainty of an alignment.

    Args:
        points: (N, COLUMNS) of the keyframe for each level.
        images: The frame.
        alignment: The alignment of the frame with the points.
        prior: The prior of its motion.
        velocity_noise: (2,) change of the velocity from frame to frame, m/s and rad/s.
    """
    shutter, finest = images.shutter, points[0]
    bands = accumulate(finest, alignment.samples, alignment.cell_weights, alignment.residual_model)
    H, _ = expand_rolling_shutter(bands, shutter.readout_s, shutter.skew_s)
    scores, moments = accumulate_scores(
        finest,
        alignment.samples,
        alignment.cell_weights,
        alignment.residual_model,
        images.levels[0],
    )
    scores = np.vstack([scores, _band_scores(bands, shutter)])
    in_keyframe = COVARIANCE_INFLATION * _sandwich_covariance(H, scores, prior)
    in_keyframe += _velocity_noise_covariance(H, bands, shutter, velocity_noise)
    in_camera = transport_covariance(in_keyframe, inverse(alignment.T_camera_keyframe))
    floor = np.diag(np.repeat(np.square(MIN_POSE_SIGMAS), 3))
    return MotionUncertainty(
        covariance=0.5 * (in_camera + in_camera.T) + floor,
        degeneracy=analyze_degeneracy(H[:6, :6], point_information(moments)),
    )


def _sandwich_covariance(H: Array, scores: Array, prior: MotionPrior) -> Array:
    """6x6 for the scatter of the scores, and for the motions of frame and keyframe."""
    prior_information = _prior_information(prior)
    bread = np.linalg.inv(_regularize(H + prior_information))
    joint_covariance = bread @ (scores.T @ scores + prior_information) @ bread
    # The keyframe's rows were corrected by a motion that has the same uncertainty.
    sensitivity = np.linalg.solve(_regularize(H[:6, :6]), H[:6, 6:])
    covariance: Array = (
        joint_covariance[:6, :6] + sensitivity @ joint_covariance[6:, 6:] @ sensitivity.T
    )
    return covariance


def _band_scores(bands: Array, shutter: ImageTiming) -> Array:
    """(2 BANDS, 15) scores of pose and motion for each band of rows."""
    scores, times_s = (
        bands[:, TRIANGLE_SIZE:],
        band_times(shutter.readout_s, shutter.skew_s)[:, None],
    )
    return np.hstack([scores, times_s * scores, 0.5 * times_s**2 * scores[:, 3:]])


def _velocity_noise_covariance(
    H: Array, bands: Array, shutter: ImageTiming, velocity_noise: Array
) -> Array:
    """6x6 for changes of the velocity during the readout of an image.

    Each band of rows, of the frame and of the keyframe, has a motion error of its own.
    """
    if shutter.is_instant:
        return np.zeros((6, 6))
    span_s = shutter.readout_s + abs(shutter.skew_s)
    # Rows are evenly distributed over that time; the error of each grows with its time.
    variance = np.repeat((span_s * velocity_noise) ** 2 / 12.0, 3)
    band_information = bands[:, UPPER_TRIANGLE]
    scatter = 2.0 * np.einsum("kij,j,klj->il", band_information, variance, band_information)
    bread = np.linalg.inv(_regularize(H[:6, :6]))
    return np.asarray(bread @ scatter @ bread, np.float64)


def _prior_information(prior: MotionPrior) -> Array:
    """(15, 15) information of the prior, which couples pose and motion."""
    information, rate_hz = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), prior.rate_hz
    pose, velocity, motion = np.arange(6), np.arange(6, 12), np.arange(6, NUM_UNKNOWNS)
    velocity_information = prior.information[:ACCELERATION_START]
    information[pose, pose] = rate_hz**2 * velocity_information
    information[pose, velocity] = information[velocity, pose] = -rate_hz * velocity_information
    information[motion, motion] = prior.information
    return information


def _regularize(H: Array) -> Array:
    return np.asarray(H + REGULARIZATION * np.trace(H) * np.eye(len(H)), np.float64)


@kernel
def accumulate_scores(
    points: Array,
    samples: Array,
    cell_weights: Array,
    residual_model: Array,
    images: LevelImages,
) -> tuple[Array, Array]:
    """(CELLS, 15) scores of pose and motion for each cell, and moments (4, 4).

    A cell's score is sum w J' r, see `expand_rolling_shutter`. The moments are sum w v^2 q q^T,
    with q the point (x, y, z, 1) and v^2 the variance of its derivative by the slope noise.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        cell_weights: (2, CELLS) of brightness and of depth.
        residual_model: (5,), see the top of `residuals`.
        images: The frame at the level.
    """
    scores, moments = np.zeros((NUM_CELLS, NUM_UNKNOWNS)), np.zeros((4, 4))
    J, q = np.empty(6), np.ones(4)
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = residual_variances(residual_model)
    readout_s, skew_s = images.readout_s, images.skew_s
    focal_px, depth_focal_px = images.intrinsics[0], images.depth_intrinsics[0]
    for i in range(len(points)):
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        depth = samples[i, SAMPLE_DEPTH_RESIDUAL]
        cell = int(samples[i, SAMPLE_CELL])
        noise = 0.0
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, POINT_BRIGHTNESS] - offset
            w = student_weight(residual, variance + points[i, POINT_BRIGHTNESS_VARIANCE])
            w *= residual_model[WEIGHT_BRIGHTNESS] * cell_weights[0, cell]
            noise += w * (gain * SLOPE_NOISE[0] * focal_px / points[i, 2]) ** 2
            fill_jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain, J)
            row = (samples[i, SAMPLE_COLOR_BAND] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(scores[cell], J, row * readout_s, w * residual)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = student_weight(depth, variance_depth)
            w *= cell_weights[1, cell]
            noise += w * (SLOPE_NOISE[1] * depth_focal_px / points[i, 2]) ** 2
            fill_jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0, J)
            row = (samples[i, SAMPLE_DEPTH_BAND] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(scores[cell], J, row * readout_s + skew_s, w * depth)
        if noise > 0.0:
            q[:3] = points[i, :3]
            for a in range(4):
                for b in range(4):
                    moments[a, b] += noise * q[a] * q[b]
    return scores, moments


@inline_kernel
def _add_score(scores: Array, J: Array, delay_s: float, weighted_residual: float) -> None:
    """Add the score of a sample at a time after the frame's stamp."""
    for k in range(6):
        scores[k] += weighted_residual * J[k]
        scores[6 + k] += delay_s * weighted_residual * J[k]
        if k >= 3:
            scores[9 + k] += 0.5 * delay_s * delay_s * weighted_residual * J[k]

"""Fusion of a measured pose with the predicted one.

The covariance of the prediction is what the last innovations exceed that of the measured pose by:
many frames of a calm camera are averaged, and one that moves is followed at once. In a direction
that the view does not constrain, the camera continues at its last velocity. Mehra, "Approaches to
Adaptive Filtering" (IEEE Transactions on Automatic Control 17, 1972).
"""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import Array, inverse
from drivers.core.jit import kernel
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.gauss_newton import NO_INFORMATION
from vo_service.odometry.direct.motion import (
    compose,
    invert,
    orthonormalize_rotation,
    se3_adjoint,
    se3_exp,
    se3_log,
)
from vo_service.odometry.direct.motion_state import (
    MAX_VELOCITY_SIGMA,
    UNKNOWN_VELOCITY_SIGMA,
    MotionState,
)
from vo_service.odometry.direct.parameters import (
    FRAME_COVARIANCE_SHARE,
    MAX_SQUARED_POSE_DIFFERENCE,
    MIN_PREDICTION_SHARE,
    MOTION_DECAY,
)
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.small_matrices import (
    invert_cholesky,
    multiply,
    multiply_vector,
    transform_covariance,
)


def fuse_with_prediction(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> tuple[TrackingResult, MotionUncertainty, float]:
    """Fuse the measured pose and velocity with the predicted ones.

    Args:
        result: The measured pose and velocity.
        uncertainty: Of the measured pose.
        motion_state: The state up to the last good frame.
        stamp_s: Stamp of the frame.

    Returns:
        The fused result; its uncertainty; and the updated normalized innovation of `MotionState`.
        In a degenerate view the result is degraded, and its uncertainty grows with the time since
        the last well constrained frame.
    """
    is_degenerate = bool(uncertainty.rejection_reason)
    # The measured pose of a good view takes account of the told motion: it is not counted again.
    predicting = motion_state if is_degenerate else motion_state.with_pose_prior(None)
    told = predicting.told_motion
    extrapolated = step = NO_INFORMATION
    if is_degenerate:
        extrapolated = step = information_of_prediction(motion_state, stamp_s)
    if told is not None:
        # Drift makes the pose less certain, but not the motion since the last one.
        step = told.information
    T_world_camera, velocity, covariance, normalized_innovation = _fuse(
        (result.T_world_camera, result.alignment.camera_velocity),
        (predicting.predict_pose(stamp_s), predicting.predict_velocity(stamp_s)),
        uncertainty.covariance,
        uncertainty.degeneracy.suppress_noise(uncertainty.is_constrained),
        result.alignment.T_camera_keyframe,
        motion_state.normalized_innovation,
        (step, extrapolated),
        # The step from an extrapolated pose to a measured one is no motion of the camera.
        is_degenerate or not motion_state.is_extrapolated,
    )
    if is_degenerate:
        reason = f"degenerate view: {told.source}" if told else uncertainty.rejection_reason
        result = replace(result, degradation=reason)
        uncertainty = replace(uncertainty, covariance=covariance)
    elif motion_state.is_stale(stamp_s):
        return result, uncertainty, normalized_innovation
    return result.with_pose(T_world_camera, velocity), uncertainty, normalized_innovation


def contradiction_reason(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> str:
    """Why a measured pose around a degenerate view is rejected; "" if it is as predicted.

    What moves before the camera may hide so much that the alignment follows it.
    """
    is_weak = uncertainty.rejection_reason or motion_state.is_extrapolated
    if not is_weak or motion_state.told_motion is not None or motion_state.is_stale(stamp_s):
        return ""
    T_predicted_camera = inverse(motion_state.predict_pose(stamp_s)) @ result.T_world_camera
    innovation = se3_log(T_predicted_camera)
    measured = _constrained_information(
        invert_cholesky(uncertainty.covariance),
        uncertainty.degeneracy.suppress_noise(uncertainty.is_constrained),
        result.alignment.T_camera_keyframe,
    )
    both = measured + information_of_prediction(motion_state, stamp_s)
    # (R + P)^-1 = R^-1 - R^-1 (R^-1 + P^-1)^-1 R^-1, with R the covariance of the measured pose.
    weighted = measured @ innovation
    squared = weighted @ innovation - weighted @ np.linalg.solve(both, weighted)
    if squared <= MAX_SQUARED_POSE_DIFFERENCE:
        return ""
    return "degenerate view: the motion contradicts that of the last frames"


def information_of_prediction(motion_state: MotionState, stamp_s: float) -> Array:
    """6x6 information of the predicted pose where views have constrained too little for a while."""
    if motion_state.told_motion is not None:
        of_told_motion = np.linalg.inv(motion_state.next_drift.covariance)
        return of_told_motion + motion_state.told_motion.floor_information
    unconstrained_s = stamp_s - motion_state.well_constrained_stamp_s
    sigma_rate = np.clip(motion_state.velocity_noise, MAX_VELOCITY_SIGMA, UNKNOWN_VELOCITY_SIGMA)
    return np.diag(np.repeat((unconstrained_s * sigma_rate) ** -2.0, 3))


@kernel
def fade_innovation(normalized_innovation: float, squared: float) -> float:
    """Normalized innovation including that of the next frame; a rise counts at once.

    Args:
        normalized_innovation: See `MotionState`.
        squared: Squared innovation of the pose, divided by its covariance.
    """
    return max(MOTION_DECAY * normalized_innovation + (1.0 - MOTION_DECAY) * squared, squared)


@kernel
def _constrained_information(information: Array, W: Array, T_camera_keyframe: Array) -> Array:
    """6x6 information of a measured pose in the directions that its view constrains.

    Args:
        information: 6x6 of the measured pose, in the camera's axes.
        W: 6x6 of `DegeneracyAnalysis`, in the keyframe's axes.
        T_camera_keyframe: 4x4.
    """
    to_keyframe = se3_adjoint(invert(T_camera_keyframe))
    W_camera = multiply(multiply(se3_adjoint(T_camera_keyframe), W), to_keyframe)
    return transform_covariance(W_camera.T.copy(), information)


@kernel
def _fuse(
    measured: tuple[Array, Array],
    predicted: tuple[Array, Array],
    covariance: Array,
    W: Array,
    T_camera_keyframe: Array,
    normalized_innovation: float,
    predicted_information: tuple[Array, Array],
    uses_velocity: bool,
) -> tuple[Array, Array, Array, float]:
    """Pose 4x4 and velocity (6,) of the camera, their fused covariance 6x6, and the innovation.

    In one kernel, as each call from Python takes time.

    Args:
        measured: T_world_camera 4x4 and the camera's velocity (6,).
        predicted: The same.
        covariance: 6x6 of the measured pose.
        W: 6x6 of `DegeneracyAnalysis`, in the keyframe's axes. The information that noise alone
            adds would look like a constraint.
        T_camera_keyframe: 4x4.
        normalized_innovation: Up to the last frame, see `MotionState`.
        predicted_information: 6x6 of the motion since the last pose, and of the predicted pose,
            in a degenerate view; else zero.
        uses_velocity: Whether the measured velocity is one.
    """
    step, extrapolated = predicted_information
    innovation = se3_log(compose(invert(predicted[0]), measured[0]))
    of_covariance = invert_cholesky(covariance)
    information = _constrained_information(of_covariance, W, T_camera_keyframe)
    squared, weighted = 0.0, multiply_vector(information, innovation)
    for k in range(6):
        squared += innovation[k] * weighted[k]
    normalized_innovation = fade_innovation(normalized_innovation, squared / 6.0)
    total, prediction_share = (
        np.empty((6, 6)),
        1.0 / max(normalized_innovation - 1.0, MIN_PREDICTION_SHARE),
    )
    for i in range(6):
        for j in range(6):
            total[i, j] = prediction_share * of_covariance[i, j]
            total[i, j] += information[i, j] / FRAME_COVARIANCE_SHARE + step[i, j]
    # Share of the innovation that is taken over: P (P + R)^-1 = (P^-1 + R^-1)^-1 R^-1.
    gain = multiply(invert_cholesky(total), information)
    for i in range(6):
        for j in range(6):
            information[i, j] += extrapolated[i, j]
            gain[i, j] /= FRAME_COVARIANCE_SHARE
    # The velocity of a calm camera is averaged over more frames than its pose, as by Kalata.
    velocity, change = predicted[1].copy(), np.zeros(6)
    for k in range(6):
        change[k] = measured[1][k] - velocity[k] if uses_velocity else 0.0
    change = multiply_vector(gain, multiply_vector(gain, change))
    for k in range(6):
        velocity[k] += change[k]
    T = orthonormalize_rotation(compose(predicted[0], se3_exp(multiply_vector(gain, innovation))))
    return T, velocity, invert_cholesky(information), normalized_innovation

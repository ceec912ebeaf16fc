"""Degenerate views: the prediction fills in for the unconstrained directions.

Predicted and measured pose are fused by their information: Kalman, "A New Approach to Linear
Filtering and Prediction Problems" (Journal of Basic Engineering 82, 1960). The information that
noise alone adds is suppressed, as it would look like a constraint.
"""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import adjoint, inverse
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import PREDICTION_SIGMA_GROWTH
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.se3 import se3_exp, se3_log


def fuse_with_prediction(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> tuple[TrackingResult, MotionUncertainty]:
    """Fuse the measured with the predicted pose, and mark the result as degraded.

    The prediction gets less weight the older the last well constrained frame is.
    """
    T_world_expected = motion_state.predict_pose(stamp_s)
    innovation = se3_log(inverse(T_world_expected) @ result.T_world_camera)
    velocity_change = result.alignment.camera_velocity - motion_state.velocity
    T_camera_keyframe = result.alignment.T_camera_keyframe
    W = uncertainty.degeneracy.noise_suppression
    W = adjoint(T_camera_keyframe) @ W @ adjoint(inverse(T_camera_keyframe))
    information = W.T @ np.linalg.inv(uncertainty.covariance) @ W
    elapsed_s = stamp_s - motion_state.well_constrained_stamp_s
    prediction_sigma = elapsed_s * np.array(PREDICTION_SIGMA_GROWTH)
    covariance = np.linalg.inv(np.diag(np.repeat(prediction_sigma**-2.0, 3)) + information)
    gain = covariance @ information
    result = result.with_pose(
        T_world_expected @ se3_exp(gain @ innovation),
        motion_state.velocity + gain @ velocity_change,
    )
    return (
        replace(result, degradation=uncertainty.rejection_reason),
        replace(uncertainty, covariance=0.5 * (covariance + covariance.T)),
    )

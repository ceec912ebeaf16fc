"""A view too plain to hold the camera: along what it leaves open, it goes on as it moved before.

What was expected and what was found are weighed by how sure each is: Kalman, "A New Approach to
Linear Filtering and Prediction Problems" (Journal of Basic Engineering 82, 1960). What readings say
of their own noise is left out: noise looks like knowledge where there is nothing else.
"""

from dataclasses import replace

import numpy as np

from drivers.core.geometry import adjoint, inverse
from vo_service.odometry.direct.covariance import MotionUncertainty
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import VELOCITY_SIGMA
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.se3 import se3_exp, se3_log


def fuse_with_prediction(
    result: TrackingResult,
    uncertainty: MotionUncertainty,
    motion_state: MotionState,
    stamp_s: float,
) -> tuple[TrackingResult, MotionUncertainty]:
    """The same between what was expected and what was found, which says so, and as sure as both.

    The longer ago a view held the camera, the less is expected of it.
    """
    T_world_expected = motion_state.predict_pose(stamp_s)
    off = se3_log(inverse(T_world_expected) @ result.T_world_camera)
    change = result.alignment.camera_velocity - motion_state.velocity
    T_camera_keyframe = result.alignment.T_camera_keyframe
    W = uncertainty.degeneracy.noise_suppression
    W = adjoint(T_camera_keyframe) @ W @ adjoint(inverse(T_camera_keyframe))
    information = W.T @ np.linalg.inv(uncertainty.covariance) @ W
    strayed = (stamp_s - motion_state.well_constrained_stamp_s) * np.array(VELOCITY_SIGMA)
    covariance = np.linalg.inv(np.diag(np.repeat(strayed**-2.0, 3)) + information)
    share = covariance @ information
    result = result.with_pose(
        T_world_expected @ se3_exp(share @ off), motion_state.velocity + share @ change
    )
    return (
        replace(result, degradation=uncertainty.rejection_reason),
        replace(uncertainty, covariance=0.5 * (covariance + covariance.T)),
    )

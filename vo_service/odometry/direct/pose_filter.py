"""Alpha-beta filter of the pose: it averages many frames of a calm camera.

The pose predicted by a constant velocity is blended with the measured one. At a large innovation
the measured pose is used alone. The velocity gain follows from the pose gain as in Kalata, "The
Tracking Index: A Generalized Parameter for alpha-beta and alpha-beta-gamma Target Trackers" (IEEE
Transactions on Aerospace and Electronic Systems 20, 1984).
"""

from math import sqrt

import numpy as np

from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import MIN_POSE_GAIN
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.se3 import se3_exp, se3_log


def alpha_beta_filter(
    result: TrackingResult, covariance: Array, motion_state: MotionState, stamp_s: float
) -> tuple[TrackingResult, float]:
    """Blend the predicted and the measured pose.

    Args:
        result: The measured pose and velocity.
        covariance: 6x6 of the measured pose, as a small motion in the camera's axes.
        motion_state: The state up to the last good frame.
        stamp_s: Stamp of the frame.

    Returns:
        The filtered result, and the updated normalized innovation of `MotionState`.
    """
    T_world_expected = motion_state.predict_pose(stamp_s)
    innovation = se3_log(inverse(T_world_expected) @ result.T_world_camera)
    updated_innovation = motion_state.update_normalized_innovation(
        float(innovation @ np.linalg.solve(covariance, innovation)) / len(innovation)
    )
    pose_gain, velocity_gain = filter_gains(updated_innovation)
    if pose_gain == 1.0 or motion_state.is_stale(stamp_s):
        return result, updated_innovation
    velocity_change = result.alignment.camera_velocity - motion_state.velocity
    T_world_camera = T_world_expected @ se3_exp(pose_gain * innovation)
    return result.with_pose(
        T_world_camera, motion_state.velocity + velocity_gain * velocity_change
    ), updated_innovation


def filter_gains(normalized_innovation: float) -> tuple[float, float]:
    """Gains of the pose and of the velocity, up to 1 for an unexpected motion."""
    pose_gain = min(max(normalized_innovation - 1.0, MIN_POSE_GAIN), 1.0)
    return pose_gain, min(2.0 * (2.0 - pose_gain) - 4.0 * sqrt(1.0 - pose_gain), 1.0)

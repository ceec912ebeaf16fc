"""A calm camera's pose is that of many frames, an agitated one's that of each frame.

What is expected of a constant velocity and what a frame says are blended: an alpha-beta filter,
whose velocity gain follows from that of the pose as in Kalata, "The Tracking Index: A Generalized
Parameter for alpha-beta and alpha-beta-gamma Target Trackers" (IEEE Transactions on Aerospace and
Electronic Systems 20, 1984).
"""

from math import sqrt

import numpy as np

from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import SLIGHT
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.se3 import se3_exp, se3_log


def alpha_beta_filter(
    result: TrackingResult, covariance: Array, motion_state: MotionState, stamp_s: float
) -> tuple[TrackingResult, float]:
    """The same between what was expected and what was found; and the unrest with it, see `Way`.

    covariance  6x6 of the pose that was found, as a small motion in the camera's axes
    """
    T_world_expected = motion_state.predict_pose(stamp_s)
    off = se3_log(inverse(T_world_expected) @ result.T_world_camera)
    unrest = motion_state.update_normalized_innovation(
        float(off @ np.linalg.solve(covariance, off)) / len(off)
    )
    of_pose, of_velocity = filter_gains(unrest)
    if of_pose == 1.0 or motion_state.is_stale(stamp_s):
        return result, unrest
    change = result.alignment.camera_velocity - motion_state.velocity
    T_world_camera = T_world_expected @ se3_exp(of_pose * off)
    return result.with_pose(T_world_camera, motion_state.velocity + of_velocity * change), unrest


def filter_gains(normalized_innovation: float) -> tuple[float, float]:
    """A frame's shares in the pose and in the velocity, up to 1: all where it is unexpected."""
    of_pose = min(max(normalized_innovation - 1.0, SLIGHT), 1.0)
    return of_pose, min(2.0 * (2.0 - of_pose) - 4.0 * sqrt(1.0 - of_pose), 1.0)

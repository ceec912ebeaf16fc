"""A calm camera's pose is that of many frames, an agitated one's that of each frame.

What is expected of a constant velocity and what a frame says are blended: an alpha-beta filter,
whose velocity gain follows from that of the pose as in Kalata, "The Tracking Index: A Generalized
Parameter for alpha-beta and alpha-beta-gamma Target Trackers" (IEEE Transactions on Aerospace and
Electronic Systems 20, 1984).
"""

from math import sqrt

import numpy as np

from drivers.geometry import Array, inverse
from vo_service.odometry.keyframe.parameters import SLIGHT
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.twists import exponential, logarithm
from vo_service.odometry.keyframe.way import Way


def steadied(found: Found, covariance: Array, way: Way, stamp_s: float) -> tuple[Found, float]:
    """The same between what was expected and what was found; and the unrest with it, see `Way`.

    covariance  6x6 of the pose that was found, as a small motion in the camera's axes
    """
    T_world_expected = way.expected(stamp_s)
    off = logarithm(inverse(T_world_expected) @ found.T_world_camera)
    unrest = way.unrest_with(float(off @ np.linalg.solve(covariance, off)) / len(off))
    of_pose, of_velocity = shares(unrest)
    if of_pose == 1.0 or way.is_long_ago(stamp_s):
        return found, unrest
    change = found.alignment.camera_velocity - way.velocity
    T_world_camera = T_world_expected @ exponential(of_pose * off)
    return found.moved(T_world_camera, way.velocity + of_velocity * change), unrest


def shares(unrest: float) -> tuple[float, float]:
    """A frame's shares in the pose and in the velocity, up to 1: all where it is unexpected."""
    of_pose = min(max(unrest - 1.0, SLIGHT), 1.0)
    return of_pose, min(2.0 * (2.0 - of_pose) - 4.0 * sqrt(1.0 - of_pose), 1.0)

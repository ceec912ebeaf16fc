"""A view too plain to hold the camera: along what it leaves open, it goes on as it moved before.

What was expected and what was found are weighed by how sure each is: Kalman, "A New Approach to
Linear Filtering and Prediction Problems" (Journal of Basic Engineering 82, 1960). What readings say
of their own noise is left out: noise looks like knowledge where there is nothing else.
"""

from dataclasses import replace

import numpy as np

from drivers.geometry import adjoint, inverse
from vo_service.odometry.keyframe.certainty import Certainty
from vo_service.odometry.keyframe.parameters import VELOCITY_SIGMA
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.twists import exponential, logarithm
from vo_service.odometry.keyframe.way import Way


def carried_on(found: Found, sure: Certainty, way: Way, stamp_s: float) -> tuple[Found, Certainty]:
    """The same between what was expected and what was found, which says so, and as sure as both.

    The longer ago a view held the camera, the less is expected of it.
    """
    T_world_expected = way.expected(stamp_s)
    off = logarithm(inverse(T_world_expected) @ found.T_world_camera)
    change = found.alignment.camera_velocity - way.velocity
    T_camera_keyframe = found.alignment.T_camera_keyframe
    W = sure.directions.without_noise
    W = adjoint(T_camera_keyframe) @ W @ adjoint(inverse(T_camera_keyframe))
    information = W.T @ np.linalg.inv(sure.covariance) @ W
    strayed = (stamp_s - way.held_s) * np.array(VELOCITY_SIGMA)
    covariance = np.linalg.inv(np.diag(np.repeat(strayed**-2.0, 3)) + information)
    share = covariance @ information
    found = found.moved(T_world_expected @ exponential(share @ off), way.velocity + share @ change)
    return (
        replace(found, lack=sure.doubt),
        replace(sure, covariance=0.5 * (covariance + covariance.T)),
    )

"""A view too plain to hold the camera: along what it leaves open, it goes on as it moved before.

An estimate shrunk by its own noise, towards what was expected of it: James and Stein, "Estimation
with Quadratic Loss" (Fourth Berkeley Symposium, 1961).
"""

from dataclasses import replace

import numpy as np

from drivers.geometry import carried, inverse
from vo_service.odometry.keyframe.certainty import Certainty
from vo_service.odometry.keyframe.movement import ACCELERATION
from vo_service.odometry.keyframe.parameters import VELOCITY_SIGMA
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.twists import exponential, logarithm
from vo_service.odometry.keyframe.way import Way


def carried_on(found: Found, sure: Certainty, way: Way, stamp_s: float) -> tuple[Found, Certainty]:
    """The same between what was expected and what was found, which says so, and is less sure.

    Each direction of motion has the share of what was found that is more than noise. Of the rest,
    the longer ago the camera was held the less is known.
    """
    share, alignment = sure.directions.share, found.alignment
    T_world_keyframe = found.keyframe.T_world_keyframe
    T_expected = way.starts(T_world_keyframe, stamp_s)[0]
    movement = way.tie(T_world_keyframe, stamp_s).movement
    change = (alignment.movement - movement)[:ACCELERATION]
    movement[:ACCELERATION] += share @ change
    off = logarithm(inverse(T_expected) @ alignment.T_camera_keyframe)
    alignment = replace(
        alignment,
        T_camera_keyframe=T_expected @ exponential(share @ off),
        movement=movement,
    )
    strayed = (np.eye(6) - share) * (stamp_s - way.held_s) * np.repeat(VELOCITY_SIGMA, 3)
    of_stray = carried(strayed @ strayed.T, inverse(alignment.T_camera_keyframe))
    return (
        replace(found, alignment=alignment, lack=sure.doubt),
        replace(sure, covariance=sure.covariance + of_stray),
    )

"""Motions that were found so far from where a briskly moving camera was expected."""

import numpy as np

from drivers.geometry import Array, inverse
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, seen, series_exponential
from vo_service.odometry.keyframe.alignment import Alignment, start_fit
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.images import make_images
from vo_service.odometry.keyframe.local_map import make_keyframe
from vo_service.odometry.keyframe.movement import at_constant, at_rest, in_axes
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.way import SAME_LIGHT, Way

T_WORLD_KEYFRAME = BRISK.at(-0.1)
KEYFRAME = make_keyframe(seen(), make_images(seen()), T_WORLD_KEYFRAME, at_rest(), ALL_STILL)
WAY = Way(BRISK.at(1.0), BRISK.velocity, 1.0, SAME_LIGHT, 120.0, held_s=1.0)
STAMP_S = 1.0 + 1 / 30


def found_at(off: Array, faster: Array) -> Found:
    """So far from where it is expected (6,), and with another velocity (6,)."""
    T_camera_keyframe = inverse(BRISK.at(STAMP_S) @ series_exponential(off)) @ T_WORLD_KEYFRAME
    movement = in_axes(-at_constant(BRISK.velocity + faster), inverse(T_camera_keyframe))
    nothing = np.zeros((0, 0))
    alignment = Alignment(T_camera_keyframe, movement, start_fit(), nothing, nothing, nothing)
    return Found(KEYFRAME, alignment, WAY.tie(T_WORLD_KEYFRAME, STAMP_S))

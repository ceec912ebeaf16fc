"""Keyframes of a corner with ground truth."""

from collections.abc import Sequence

import numpy as np

from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.slam.keyframe_database import MapKeyframe, QueryFrame
from vo_service.slam.place_recognizer import PlaceRecognizer

ZERO_VELOCITY = np.zeros(6)


def make_pose(shift_m: Sequence[float], turn_deg: Sequence[float] = (0.0, 0.0, 0.0)) -> Array:
    """4x4 T_world_camera."""
    return rigid_transform(so3_exp(np.radians(turn_deg)), shift_m)


HERE = make_pose((0.0, 0.0, 0.0))
BESIDE = make_pose((0.15, -0.05, 0.1), (3.0, -6.0, 2.0))
# A pose without overlap with HERE.
ELSEWHERE = make_pose((1.6, -0.3, 0.2), (0.0, 40.0, 0.0))


def make_query(recognizer: PlaceRecognizer, T_world_camera: Array) -> QueryFrame:
    """A query of the corner at a pose."""
    return recognizer.create_query(render_corner(T_world_camera), ZERO_VELOCITY)


def make_keyframe(
    recognizer: PlaceRecognizer, T_world_keyframe: Array, number: int = 0, world: int = 0
) -> MapKeyframe:
    """A keyframe of the corner at a pose."""
    return recognizer.create_keyframe(
        make_query(recognizer, T_world_keyframe), number, world, T_world_keyframe
    )

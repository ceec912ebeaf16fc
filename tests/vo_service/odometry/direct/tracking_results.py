"""Tracking results with a given innovation, for a moving camera."""

import numpy as np

from drivers.core.geometry import Array, inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    render_view,
    series_exponential,
)
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    initial_residual_model,
)
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, build_image_pyramid
from vo_service.odometry.direct.keyframe import make_keyframe
from vo_service.odometry.direct.motion import (
    change_frame,
    constant_velocity_motion,
    zero_motion,
)
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.residuals import ResidualCounts
from vo_service.odometry.direct.samples import empty_samples

T_WORLD_KEYFRAME = BRISK.pose_at(-0.1)
KEYFRAME = make_keyframe(
    render_view(), build_image_pyramid(render_view()), T_WORLD_KEYFRAME, zero_motion(), ALL_STATIC
)
MOTION = MotionState(
    BRISK.pose_at(1.0),
    BRISK.velocity,
    1.0,
    well_constrained_stamp_s=1.0,
)
STAMP_S = 1.0 + 1 / 30


def make_result(off: Array, faster: Array) -> TrackingResult:
    """Make a result with an innovation (6,) of the pose and of the velocity (6,)."""
    T_camera_keyframe = inverse(BRISK.pose_at(STAMP_S) @ series_exponential(off)) @ T_WORLD_KEYFRAME
    motion = change_frame(
        -constant_velocity_motion(BRISK.velocity + faster), inverse(T_camera_keyframe)
    )
    alignment = DirectAlignment(
        T_camera_keyframe,
        motion,
        initial_residual_model(KEYFRAME.images, KEYFRAME.points[0]),
        ResidualCounts(),
        empty_samples(0),
        np.zeros((0, 0)),
    )
    return TrackingResult(KEYFRAME, alignment, MOTION.motion_prior(T_WORLD_KEYFRAME, STAMP_S))

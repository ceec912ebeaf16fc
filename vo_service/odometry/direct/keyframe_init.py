"""Correction of the first keyframe, once the second frame shows the camera's velocity."""

from drivers.core.geometry import inverse
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.grid import ALL_STATIC
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.local_map import make_keyframe
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import REINITIALIZATIONS
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.rolling_shutter import constant_velocity_motion
from vo_service.odometry.direct.se3 import se3_log


def reinitialize(
    result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> TrackingResult:
    """Rebuild the first keyframe by the velocity, and align the second frame with it again."""
    for _ in range(REINITIALIZATIONS):
        old = result.keyframe
        T_first_second = inverse(result.alignment.T_camera_keyframe)
        motion = constant_velocity_motion(se3_log(T_first_second) * result.prior.rate_hz)
        keyframe = make_keyframe(old.frame, old.images, old.T_world_keyframe, motion, ALL_STATIC)
        alignment = align(
            keyframe.points,
            images,
            [result.alignment.T_camera_keyframe],
            result.prior,
            motion_state.affine_brightness,
            uniform_weights(),
        )
        result = TrackingResult(keyframe, alignment, result.prior)
    return result

"""A first keyframe is made before the camera's velocity is known; the second frame tells it."""

from drivers.core.geometry import inverse
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.grid import ALL_STATIC
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.local_map import make_keyframe
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.recovery import TrackingResult
from vo_service.odometry.direct.rolling_shutter import constant_velocity_motion
from vo_service.odometry.direct.se3 import se3_log

# Each time the keyframe's rows are brought to its stamp by the velocity that was found before: none
# where the second frame comes too late to tell.
ITERATIONS = 2


def reinitialize(
    result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> TrackingResult:
    """The second frame, laid on the first one made into a keyframe again."""
    for _ in range(ITERATIONS):
        before = result.keyframe
        T_first_second = inverse(result.alignment.T_camera_keyframe)
        movement = constant_velocity_motion(se3_log(T_first_second) * result.prior.rate_hz)
        keyframe = make_keyframe(
            before.frame, before.images, before.T_world_keyframe, movement, ALL_STATIC
        )
        start = result.alignment.T_camera_keyframe
        again = align(
            keyframe.points,
            images,
            [start],
            result.prior,
            motion_state.affine_brightness,
            uniform_weights(),
        )
        result = TrackingResult(keyframe, again, result.prior)
    return result

"""A first keyframe is made before the camera's velocity is known; the second frame tells it."""

from drivers.geometry import inverse
from vo_service.odometry.keyframe.alignment import align, uniform_weights
from vo_service.odometry.keyframe.cells import ALL_STATIC
from vo_service.odometry.keyframe.images import ImagePyramid
from vo_service.odometry.keyframe.local_map import make_keyframe
from vo_service.odometry.keyframe.movement import constant_velocity_motion
from vo_service.odometry.keyframe.recovery import TrackingResult
from vo_service.odometry.keyframe.twists import se3_log
from vo_service.odometry.keyframe.way import MotionState

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

"""A first keyframe is made before the camera's velocity is known; the second frame tells it."""

from drivers.geometry import inverse
from vo_service.odometry.keyframe.alignment import align, all_alike
from vo_service.odometry.keyframe.cells import ALL_STILL
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.local_map import make_keyframe
from vo_service.odometry.keyframe.movement import at_constant
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.twists import logarithm
from vo_service.odometry.keyframe.way import Way

# Each time the keyframe's rows are brought to its stamp by the velocity that was found before: none
# where the second frame comes too late to tell.
ROUNDS = 2


def made_anew(found: Found, images: Images, way: Way) -> Found:
    """The second frame, laid on the first one made into a keyframe again."""
    for _ in range(ROUNDS):
        before = found.keyframe
        T_first_second = inverse(found.alignment.T_camera_keyframe)
        movement = at_constant(logarithm(T_first_second) * found.tie.rate_hz)
        keyframe = make_keyframe(
            before.frame, before.images, before.T_world_keyframe, movement, ALL_STILL
        )
        start = found.alignment.T_camera_keyframe
        again = align(keyframe.points, images, [start], found.tie, way.light, all_alike())
        found = Found(keyframe, again, found.tie)
    return found

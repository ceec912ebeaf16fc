"""When the next keyframe is due, and which it is: this frame, or one that was in use before."""

from dataclasses import replace
from math import sqrt

from drivers.camera import RgbdFrame
from vo_service.odometry.keyframe.confidence import hidden, lack
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.joint import align_jointly
from vo_service.odometry.keyframe.limits import MOST
from vo_service.odometry.keyframe.local_map import (
    Keyframe,
    LocalMap,
    Overlap,
    make_keyframe,
    overlap,
)
from vo_service.odometry.keyframe.parameters import (
    HALF,
    KEYFRAME_FLOW_PX,
    KEYFRAMES,
    LITTLE,
    OTHER_LIGHT,
    SIGMAS,
)
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.strangers import without_strangers

# So many others have a say in where the next one is.
JOINT_KEYFRAMES, *_ = KEYFRAMES
# One that is used again has moved so little in the image.
REUSE_PX = KEYFRAME_FLOW_PX / sqrt(2.0)


def is_due(found: Found, images: Images, clarity: float, clarity_at_first: float) -> bool:
    """Whether the keyframe in use is going out of view, or says little, or knows but the dark.

    clarity  of the direction that the view says the least of, now and in the keyframe's first view;
             the ratio of entropies of Kerl, Sturm and Cremers (IROS 2013), where it matters
    """
    # Where the light is back there is texture that a keyframe without it does not know of.
    if lack(found.alignment) and images.light_against(found.keyframe.images) > OTHER_LIGHT:
        return True
    if SIGMAS <= clarity < min(2.0 * SIGMAS, HALF * clarity_at_first):
        return True
    seen = overlap(found.keyframe, found.alignment.T_camera_keyframe)
    return not _is_near(seen, KEYFRAME_FLOW_PX)


def settle(found: Found, images: Images, local_map: LocalMap) -> Found:
    """The same frame, laid on other keyframes in view as well."""
    keyframe, alignment = found.keyframe, found.alignment
    others = [
        other
        for other, seen in local_map.in_view(found.T_world_camera)
        if other is not keyframe and seen.share >= HALF
    ][:JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, images, alignment)
    return replace(found, alignment=replace(alignment, T_camera_keyframe=T))


def choose(frame: RgbdFrame, images: Images, found: Found, local_map: LocalMap) -> Keyframe:
    """One of the map that is near enough, else the frame itself, which joins the map."""
    T_world_camera = found.T_world_camera
    for other, seen in local_map.in_view(T_world_camera):
        if other is not found.keyframe and _is_near(seen, REUSE_PX):
            local_map.use(other)
            return other
    if hidden(found.alignment) > LITTLE:
        return found.keyframe
    keyframe = make_keyframe(
        frame, images, T_world_camera, found.alignment.camera_movement, found.alignment.is_still
    )
    keyframe = without_strangers(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < LITTLE * len(found.keyframe.points[0]):
        return found.keyframe
    local_map.add(keyframe)
    return keyframe


def _is_near(seen: Overlap, flow_px: float) -> bool:
    return seen.share >= MOST and seen.flow_px <= flow_px

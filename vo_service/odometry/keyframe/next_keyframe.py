"""When the next keyframe is due, and which it is: this frame, or one that was in use before."""

from dataclasses import replace
from math import sqrt

from drivers.geometry import inverse
from vo_service.odometry.keyframe.confidence import hidden, lack
from vo_service.odometry.keyframe.good_frame import GoodFrame, movement_before
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
from vo_service.odometry.keyframe.strangers import without_strangers

# So many others have a say in where the next one is.
JOINT_KEYFRAMES, *_ = KEYFRAMES
# One that is used again has moved by no more in the image. Where frames come seldom the next one is
# far on, and the next keyframe is due when the last has moved by more.
NEAR_PX = KEYFRAME_FLOW_PX / sqrt(2.0)


def is_due(good: GoodFrame, clarity: float, clarity_at_first: float) -> bool:
    """Whether the keyframe in use is going out of view, or says little, or knows but the dark.

    clarity  of the direction that the view says the least of, now and in the keyframe's first view;
             the ratio of entropies of Kerl, Sturm and Cremers (IROS 2013), where it matters
    """
    found, images = good.found, good.images
    # Where the light is back there is texture that a keyframe without it does not know of.
    if lack(found.alignment) and images.light_against(found.keyframe.images) > OTHER_LIGHT:
        return True
    if SIGMAS <= clarity < min(2.0 * SIGMAS, HALF * clarity_at_first):
        return True
    seen = overlap(found.keyframe, found.alignment.T_camera_keyframe)
    is_seldom = good.way.is_long_ago(images.stamp_s)
    return not _is_near(seen, NEAR_PX if is_seldom else KEYFRAME_FLOW_PX)


def settle(
    before: GoodFrame | None, now: GoodFrame, local_map: LocalMap
) -> tuple[GoodFrame, GoodFrame]:
    """The frame to make the next keyframe of, laid on others in view as well; and now, from there.

    before  the good frame before this one: a rolling shutter's keyframe is made of that, for by now
            it is known how the camera moved in it
    """
    movement = movement_before(before, now)
    if before is None or movement is None:
        settled = _settled(now, local_map)
        return settled, settled
    settled = _settled(before, local_map)
    T_before_now = inverse(before.found.T_world_camera) @ now.found.T_world_camera
    T_world_camera = settled.found.T_world_camera @ T_before_now
    found = now.found.moved(T_world_camera, now.found.alignment.camera_velocity)
    return settled.with_movement(movement), replace(now, found=found)


def _settled(good: GoodFrame, local_map: LocalMap) -> GoodFrame:
    """The same on other keyframes in view as well; as it is where the view is plain."""
    if not good.is_held:
        return good
    keyframe, alignment = good.found.keyframe, good.found.alignment
    others = [
        other
        for other, seen in local_map.in_view(good.found.T_world_camera)
        if other is not keyframe and seen.share >= HALF
    ][:JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, good.images, alignment)
    found = replace(good.found, alignment=replace(alignment, T_camera_keyframe=T))
    return replace(good, found=found)


def choose(good: GoodFrame, local_map: LocalMap) -> Keyframe:
    """One of the map that is near enough, else the frame itself, which joins the map."""
    found, alignment = good.found, good.found.alignment
    for other, seen in local_map.in_view(found.T_world_camera):
        if other is not found.keyframe and _is_near(seen, NEAR_PX):
            local_map.use(other)
            return other
    if hidden(alignment) > LITTLE:
        return found.keyframe
    keyframe = make_keyframe(
        good.frame,
        good.images,
        found.T_world_camera,
        alignment.camera_movement,
        alignment.is_still,
    )
    keyframe = without_strangers(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < LITTLE * len(found.keyframe.points[0]):
        return found.keyframe
    local_map.add(keyframe)
    return keyframe


def _is_near(seen: Overlap, flow_px: float) -> bool:
    return seen.share >= MOST and seen.flow_px <= flow_px

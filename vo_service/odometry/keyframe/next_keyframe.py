"""When the next keyframe is due, and which it is: this frame, or one that was in use before."""

from dataclasses import replace

from drivers.camera import RgbdFrame
from vo_service.odometry.keyframe.confidence import hidden, lack
from vo_service.odometry.keyframe.images import Images
from vo_service.odometry.keyframe.joint import align_jointly
from vo_service.odometry.keyframe.local_map import (
    Keyframe,
    LocalMap,
    Overlap,
    make_keyframe,
    overlap,
)
from vo_service.odometry.keyframe.parameters import (
    JOINT_KEYFRAMES,
    KEYFRAME_FLOW_PX,
    KEYFRAME_OVERLAP,
    LEAST_DEPTH,
    LITTLE,
    OTHER_LIGHT,
)
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.strangers import without_strangers

# Shares of a keyframe in view: of the one in use, and of another that has a say.
IN_USE, HAS_A_SAY = KEYFRAME_OVERLAP
# How far the one in use may move in the image, and another that is used again.
IN_USE_PX, REUSE_PX = KEYFRAME_FLOW_PX


def is_due(found: Found, images: Images) -> bool:
    """Whether the keyframe in use is going out of view, or is of the dark and there is light."""
    # Where the light is back there is texture that a keyframe without it does not know of.
    if lack(found.alignment) and images.light_against(found.keyframe.images) > OTHER_LIGHT:
        return True
    seen = overlap(found.keyframe, found.alignment.T_camera_keyframe)
    return not _is_near(seen, IN_USE_PX)


def settle(found: Found, images: Images, local_map: LocalMap) -> Found:
    """The same frame, laid on other keyframes in view as well."""
    keyframe, alignment = found.keyframe, found.alignment
    others = [
        other
        for other, seen in local_map.in_view(found.T_world_camera)
        if other is not keyframe and seen.share >= HAS_A_SAY
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
        frame, images, T_world_camera, found.alignment.camera_velocity, found.alignment.is_still
    )
    keyframe = without_strangers(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < LEAST_DEPTH * len(found.keyframe.points[0]):
        return found.keyframe
    local_map.add(keyframe)
    return keyframe


def _is_near(seen: Overlap, flow_px: float) -> bool:
    return seen.share >= IN_USE and seen.flow_px <= flow_px

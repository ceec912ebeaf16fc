"""When the next keyframe is due, and which it is: this frame, or one that was in use before."""

from dataclasses import replace

from drivers.camera import RgbdFrame
from vo_service.odometry.keyframe.confidence import MUCH_HIDDEN, hidden, lack
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
    REUSE_FLOW_PX,
)
from vo_service.odometry.keyframe.recovery import Found
from vo_service.odometry.keyframe.strangers import without_strangers

# Another keyframe has a say if at least this share of it is in view.
JOINT_OVERLAP = 0.5
# A view so many times as bright has texture that a keyframe without it does not know of.
LIGHT_IS_BACK = 1.5
# A frame with less depth than this share of its points is no good keyframe.
LEAST_DEPTH = 0.3


def is_due(found: Found, images: Images) -> bool:
    """Whether the keyframe in use is going out of view, or is of the dark and there is light."""
    if lack(found.alignment) and images.light_against(found.keyframe.images) > LIGHT_IS_BACK:
        return True
    seen = overlap(found.keyframe, found.alignment.T_camera_keyframe)
    return not _is_near(seen, KEYFRAME_OVERLAP, KEYFRAME_FLOW_PX)


def settle(found: Found, images: Images, local_map: LocalMap) -> Found:
    """The same frame, laid on other keyframes in view as well."""
    keyframe, alignment = found.keyframe, found.alignment
    others = [
        other
        for other, seen in local_map.in_view(found.T_world_camera)
        if other is not keyframe and seen.share >= JOINT_OVERLAP
    ][:JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, images, alignment)
    return replace(found, alignment=replace(alignment, T_camera_keyframe=T))


def choose(frame: RgbdFrame, images: Images, found: Found, local_map: LocalMap) -> Keyframe:
    """One of the map that is near enough, else the frame itself, which joins the map."""
    T_world_camera = found.T_world_camera
    for other, seen in local_map.in_view(T_world_camera):
        if other is not found.keyframe and _is_near(seen, KEYFRAME_OVERLAP, REUSE_FLOW_PX):
            local_map.use(other)
            return other
    if hidden(found.alignment) > MUCH_HIDDEN:
        return found.keyframe
    keyframe = make_keyframe(
        frame, images, T_world_camera, found.alignment.camera_velocity, found.alignment.is_still
    )
    keyframe = without_strangers(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < LEAST_DEPTH * len(found.keyframe.points[0]):
        return found.keyframe
    local_map.add(keyframe)
    return keyframe


def _is_near(seen: Overlap, share: float, flow_px: float) -> bool:
    return seen.share >= share and seen.flow_px <= flow_px

"""When the next keyframe is due, and which it is: this frame, or one that was in use before."""

from dataclasses import replace
from math import sqrt

from drivers.core.geometry import inverse
from vo_service.odometry.direct.derived_parameters import MIN_CONSISTENT_SHARE
from vo_service.odometry.direct.dynamic_points import remove_dynamic_points
from vo_service.odometry.direct.local_map import (
    DirectKeyframe,
    KeyframeOverlap,
    LocalMap,
    compute_overlap,
    make_keyframe,
)
from vo_service.odometry.direct.multi_keyframe_alignment import align_jointly
from vo_service.odometry.direct.parameters import (
    GATE_SIGMAS,
    HALF,
    KEYFRAME_COUNTS,
    LITTLE,
    MAX_BRIGHTNESS_RATIO,
    MAX_KEYFRAME_FLOW_PX,
)
from vo_service.odometry.direct.quality import degradation_reason, occluded_fraction
from vo_service.odometry.direct.tracked_frame import TrackedFrame, estimate_previous_motion

# So many others have a say in where the next one is.
MAX_JOINT_KEYFRAMES, *_ = KEYFRAME_COUNTS
# One that is used again has moved by no more in the image. Where frames come seldom the next one is
# far on, and the next keyframe is due when the last has moved by more.
MAX_REUSE_FLOW_PX = MAX_KEYFRAME_FLOW_PX / sqrt(2.0)


def needs_keyframe(
    tracked: TrackedFrame, observability: float, initial_observability: float
) -> bool:
    """Whether the keyframe in use is going out of view, or says little, or knows but the dark.

    clarity  of the direction that the view says the least of, now and in the keyframe's first view;
             the ratio of entropies of Kerl, Sturm and Cremers (IROS 2013), where it matters
    """
    found, images = tracked.result, tracked.images
    # Where the light is back there is texture that a keyframe without it does not know of.
    if (
        degradation_reason(found.alignment)
        and images.brightness_ratio(found.keyframe.images) > MAX_BRIGHTNESS_RATIO
    ):
        return True
    if GATE_SIGMAS <= observability < min(2.0 * GATE_SIGMAS, HALF * initial_observability):
        return True
    seen = compute_overlap(found.keyframe, found.alignment.T_camera_keyframe)
    is_seldom = tracked.motion_state.is_stale(images.stamp_s)
    return not _has_large_overlap(seen, MAX_REUSE_FLOW_PX if is_seldom else MAX_KEYFRAME_FLOW_PX)


def refine(
    before: TrackedFrame | None, now: TrackedFrame, local_map: LocalMap
) -> tuple[TrackedFrame, TrackedFrame]:
    """The frame to make the next keyframe of, laid on others in view as well; and now, from there.

    before  the good frame before this one: a rolling shutter's keyframe is made of that, for by now
            it is known how the camera moved in it
    """
    movement = estimate_previous_motion(before, now)
    if before is None or movement is None:
        settled = _refine_jointly(now, local_map)
        return settled, settled
    settled = _refine_jointly(before, local_map)
    T_before_now = inverse(before.result.T_world_camera) @ now.result.T_world_camera
    T_world_camera = settled.result.T_world_camera @ T_before_now
    found = now.result.with_pose(T_world_camera, now.result.alignment.camera_velocity)
    return settled.with_motion(movement), replace(now, result=found)


def _refine_jointly(tracked: TrackedFrame, local_map: LocalMap) -> TrackedFrame:
    """The same on other keyframes in view as well; as it is where the view is plain."""
    if not tracked.is_well_constrained:
        return tracked
    keyframe, alignment = tracked.result.keyframe, tracked.result.alignment
    others = [
        other
        for other, seen in local_map.rank_by_overlap(tracked.result.T_world_camera)
        if other is not keyframe and seen.share >= HALF
    ][:MAX_JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, tracked.images, alignment)
    found = replace(tracked.result, alignment=replace(alignment, T_camera_keyframe=T))
    return replace(tracked, result=found)


def select(tracked: TrackedFrame, local_map: LocalMap) -> DirectKeyframe:
    """One of the map that is near enough, else the frame itself, which joins the map."""
    found, alignment = tracked.result, tracked.result.alignment
    for other, seen in local_map.rank_by_overlap(found.T_world_camera):
        if other is not found.keyframe and _has_large_overlap(seen, MAX_REUSE_FLOW_PX):
            local_map.move_to_newest(other)
            return other
    if occluded_fraction(alignment) > LITTLE:
        return found.keyframe
    keyframe = make_keyframe(
        tracked.frame,
        tracked.images,
        found.T_world_camera,
        alignment.camera_motion,
        alignment.is_static,
    )
    keyframe = remove_dynamic_points(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < LITTLE * len(found.keyframe.points[0]):
        return found.keyframe
    local_map.add(keyframe)
    return keyframe


def _has_large_overlap(overlap: KeyframeOverlap, max_flow_px: float) -> bool:
    return overlap.share >= MIN_CONSISTENT_SHARE and overlap.flow_px <= max_flow_px

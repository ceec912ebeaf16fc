"""Keyframe selection: when the next keyframe is due, and whether it is a new or an old one."""

from dataclasses import replace
from math import sqrt

from drivers.core.geometry import inverse
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
    MAX_BRIGHTNESS_RATIO,
    MAX_JOINT_KEYFRAMES,
    MAX_KEYFRAME_FLOW_PX,
    MAX_KEYFRAME_OCCLUDED_SHARE,
    MAX_WEAK_OBSERVABILITY,
    MIN_JOINT_OVERLAP,
    MIN_KEYFRAME_OVERLAP,
    MIN_KEYFRAME_POINT_SHARE,
    MIN_OBSERVABILITY_RATIO,
    MIN_VIEW_OBSERVABILITY,
)
from vo_service.odometry.direct.quality import degradation_reason, occluded_fraction
from vo_service.odometry.direct.tracked_frame import TrackedFrame, estimate_previous_motion

# Largest flow of a keyframe that is used again. If frames are rare, the next one is far away, and a
# larger flow makes the next keyframe due.
MAX_REUSE_FLOW_PX = MAX_KEYFRAME_FLOW_PX / sqrt(2.0)


def needs_keyframe(
    tracked: TrackedFrame, observability: float, initial_observability: float
) -> bool:
    """Whether the keyframe is going out of view, constrains little, or is too dark.

    Args:
        tracked: The frame that is aligned with the keyframe.
        observability: Of the least constrained direction, as by the ratio of entropies of Kerl,
            Sturm and Cremers (IROS 2013).
        initial_observability: The same in the keyframe's first view.
    """
    result, images = tracked.result, tracked.images
    # When the light is back, there is texture that a dark keyframe does not have.
    if (
        degradation_reason(result.alignment)
        and images.brightness_ratio(result.keyframe.images) > MAX_BRIGHTNESS_RATIO
    ):
        return True
    if (
        MIN_VIEW_OBSERVABILITY
        <= observability
        < min(MAX_WEAK_OBSERVABILITY, MIN_OBSERVABILITY_RATIO * initial_observability)
    ):
        return True
    overlap = compute_overlap(result.keyframe, result.alignment.T_camera_keyframe)
    is_sparse = tracked.motion_state.is_stale(images.stamp_s)
    return not _has_large_overlap(overlap, MAX_REUSE_FLOW_PX if is_sparse else MAX_KEYFRAME_FLOW_PX)


def refine(
    before: TrackedFrame | None, now: TrackedFrame, local_map: LocalMap
) -> tuple[TrackedFrame, TrackedFrame]:
    """Refine the pose of the next keyframe by aligning it with other keyframes in view.

    Args:
        before: The good frame before this one, if any. With a rolling shutter the keyframe is made
            of it, since its motion is known by now.
        now: The current frame.
        local_map: The keyframes.

    Returns:
        The frame that becomes the keyframe, and the current frame relative to it.
    """
    motion = estimate_previous_motion(before, now)
    if before is None or motion is None:
        refined = _refine_jointly(now, local_map)
        return refined, refined
    refined = _refine_jointly(before, local_map)
    T_before_now = inverse(before.result.T_world_camera) @ now.result.T_world_camera
    T_world_camera = refined.result.T_world_camera @ T_before_now
    result = now.result.with_pose(T_world_camera, now.result.alignment.camera_velocity)
    return refined.with_motion(motion), replace(now, result=result)


def _refine_jointly(tracked: TrackedFrame, local_map: LocalMap) -> TrackedFrame:
    """Align with other keyframes in view as well; unchanged if the view is degenerate."""
    if not tracked.is_well_constrained:
        return tracked
    keyframe, alignment = tracked.result.keyframe, tracked.result.alignment
    others = [
        other
        for other, overlap in local_map.rank_by_overlap(tracked.result.T_world_camera)
        if other is not keyframe and overlap.share >= MIN_JOINT_OVERLAP
    ][:MAX_JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, tracked.images, alignment)
    result = replace(tracked.result, alignment=replace(alignment, T_camera_keyframe=T))
    return replace(tracked, result=result)


def select(tracked: TrackedFrame, local_map: LocalMap) -> DirectKeyframe:
    """Return a keyframe of the map that is near enough, or add the frame to the map."""
    result, alignment = tracked.result, tracked.result.alignment
    for other, overlap in local_map.rank_by_overlap(result.T_world_camera):
        if other is not result.keyframe and _has_large_overlap(overlap, MAX_REUSE_FLOW_PX):
            local_map.move_to_newest(other)
            return other
    if occluded_fraction(alignment) > MAX_KEYFRAME_OCCLUDED_SHARE:
        return result.keyframe
    keyframe = make_keyframe(
        tracked.frame,
        tracked.images,
        result.T_world_camera,
        alignment.camera_motion,
        alignment.is_static,
    )
    keyframe = remove_dynamic_points(keyframe, local_map.keyframes)
    if len(keyframe.points[0]) < MIN_KEYFRAME_POINT_SHARE * len(result.keyframe.points[0]):
        return result.keyframe
    local_map.add(keyframe)
    return keyframe


def _has_large_overlap(overlap: KeyframeOverlap, max_flow_px: float) -> bool:
    return overlap.share >= MIN_KEYFRAME_OVERLAP and overlap.flow_px <= max_flow_px

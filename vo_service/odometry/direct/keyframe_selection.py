"""Keyframe selection: when the next keyframe is due, its pose, and whether an old one serves.

With a rolling shutter, the motion within a frame follows from its rows, aligned with a keyframe
that may itself be distorted; each keyframe would pass its distortion on to the next. The poses
before and after the frame have the same error, as they use the same keyframe, so it cancels in
between.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    align,
    initial_residual_model,
    sample_points,
    uniform_weights,
)
from vo_service.odometry.direct.dynamic_points import remove_dynamic_points
from vo_service.odometry.direct.gauss_newton import (
    TRIANGLE_SIZE,
    UPPER_TRIANGLE,
    accumulate,
)
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe import (
    DirectKeyframe,
    KeyframeOverlap,
    LocalMap,
    compute_overlap,
    make_keyframe,
)
from vo_service.odometry.direct.motion import (
    change_frame,
    compose,
    constant_velocity_motion,
    fit_through_poses,
    orthonormalize_rotation,
    se3_adjoint,
    se3_exp,
    se3_log,
)
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    INITIAL_MODEL_UPDATES,
    MAX_BRIGHTNESS_RATIO,
    MAX_JOINT_KEYFRAMES,
    MAX_KEYFRAME_FLOW,
    MAX_OCCLUDED_SHARE,
    MIN_IN_VIEW_SHARE,
    MIN_KEYFRAME_OVERLAP,
    MIN_KEYFRAME_POINTS,
    NUM_JOINT_STEPS,
)
from vo_service.odometry.direct.quality import (
    TrackingResult,
    degradation_reason,
    is_consistent,
    occluded_fraction,
)
from vo_service.odometry.direct.residuals import (
    ResidualModel,
    count_residuals,
    fit_residual_model,
    weigh_regions,
    weigh_samples,
)
from vo_service.odometry.direct.small_matrices import solve_cholesky

# Largest flow of a keyframe that is used again. If frames are rare, the next one is far away, and a
# larger flow makes the next keyframe due.
MAX_REUSE_FLOW = MAX_KEYFRAME_FLOW / sqrt(2.0)


@dataclass(frozen=True)
class TrackedFrame:
    """A frame and its alignment.

    Attributes:
        frame: The frame.
        images: Its image pyramid.
        result: Its alignment with a keyframe.
        motion_state: The state at the good frame before it.
        is_well_constrained: Whether its view constrains all six degrees of freedom.
        timing_errors: (6, 2), see `MotionUncertainty`.
    """

    frame: RgbdFrame
    images: ImagePyramid
    result: TrackingResult
    motion_state: MotionState
    is_well_constrained: bool
    timing_errors: Array = field(default_factory=lambda: np.zeros((6, 2)))

    def with_motion(self, motion: Array) -> "TrackedFrame":
        """Return a copy with another motion (9,) of the camera in its own axes."""
        alignment = self.result.alignment
        in_keyframe = change_frame(-motion, inverse(alignment.T_camera_keyframe))
        result = replace(self.result, alignment=replace(alignment, motion=in_keyframe))
        return replace(self, result=result)


def estimate_previous_motion(before: TrackedFrame | None, now: TrackedFrame) -> Array | None:
    """Estimate the camera's motion (9,) in the frame before, from the poses around it.

    Returns None without a rolling shutter, or if the frames are not comparable.
    """
    if before is None or now.images.shutter.is_instant or not _are_comparable(before, now):
        return None
    poses = (
        before.motion_state.T_world_camera,
        before.result.T_world_camera,
        now.result.T_world_camera,
    )
    return fit_through_poses(
        poses, (before.motion_state.stamp_s, before.images.stamp_s, now.images.stamp_s)
    )


def _are_comparable(before: TrackedFrame, now: TrackedFrame) -> bool:
    """Whether both frames and the one before are well aligned with one keyframe, soon after."""
    return (
        before.result.keyframe is now.result.keyframe
        and before.is_well_constrained
        and now.is_well_constrained
        and not before.motion_state.is_extrapolated
        and not before.result.degradation
        and before.motion_state.is_recent(before.images.stamp_s)
        and now.motion_state.is_recent(now.images.stamp_s)
        and not before.motion_state.is_stale(now.images.stamp_s)
    )


def needs_keyframe(tracked: TrackedFrame) -> bool:
    """Whether the keyframe of a frame is going out of view, or is too dark."""
    result, images = tracked.result, tracked.images
    # When the light is back, there is texture that a dark keyframe does not have.
    if (
        degradation_reason(result.alignment)
        and images.brightness_ratio(result.keyframe.images) > MAX_BRIGHTNESS_RATIO
    ):
        return True
    overlap = compute_overlap(result.keyframe, result.alignment.T_camera_keyframe)
    is_sparse = tracked.motion_state.is_stale(images.stamp_s)
    return not _has_large_overlap(overlap, MAX_REUSE_FLOW if is_sparse else MAX_KEYFRAME_FLOW)


def _has_large_overlap(overlap: KeyframeOverlap, max_flow: float) -> bool:
    return overlap.share >= MIN_KEYFRAME_OVERLAP and overlap.flow <= max_flow


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
        if other is not keyframe and overlap.share >= MIN_IN_VIEW_SHARE
    ][:MAX_JOINT_KEYFRAMES]
    T = align_jointly(keyframe, others, tracked.images, alignment)
    result = replace(tracked.result, alignment=replace(alignment, T_camera_keyframe=T))
    return replace(tracked, result=result)


@dataclass(eq=False)
class _KeyframeFit:
    """A keyframe, its pose relative to the active one, and its residual model."""

    keyframe: DirectKeyframe
    T_keyframe_active: Array
    residual_model: ResidualModel
    is_active: bool = False


def align_jointly(
    active: DirectKeyframe,
    others: Sequence[DirectKeyframe],
    images: ImagePyramid,
    alignment: DirectAlignment,
) -> Array:
    """Estimate T_camera_active (4x4) from the active keyframe and the others.

    The poses of the keyframes and the motion stay fixed. A keyframe that does not agree with the
    frame is left out.

    Args:
        active: The active keyframe.
        others: Other keyframes in view.
        images: The frame.
        alignment: Of the frame with the active keyframe.
    """
    T = alignment.T_camera_keyframe
    fits = [_KeyframeFit(active, np.eye(4), alignment.residual_model, is_active=True)]
    for other in others:
        T_other_active = inverse(other.T_world_keyframe) @ active.T_world_keyframe
        residual_model = initial_residual_model(images, other.points[0])
        fits.append(_KeyframeFit(other, T_other_active, residual_model))
    for step in range(NUM_JOINT_STEPS):
        H, g = np.zeros((6, 6)), np.zeros(6)
        for fit in list(fits):
            sums = _linearize(fit, images, T, alignment.motion, step)
            if sums is None:
                fits.remove(fit)
                continue
            Ad = se3_adjoint(fit.T_keyframe_active)
            H += Ad.T @ sums[UPPER_TRIANGLE] @ Ad
            g += Ad.T @ sums[TRIANGLE_SIZE:]
        T = compose(T, se3_exp(-solve_cholesky(H, g)))
    return orthonormalize_rotation(T)


def _linearize(
    fit: _KeyframeFit, images: ImagePyramid, T_camera_active: Array, motion: Array, step: int
) -> Array | None:
    """Update a keyframe's residual model, and sum up its normal equations.

    Args:
        fit: The keyframe; its residual model is updated.
        images: The frame.
        T_camera_active: 4x4.
        motion: (9,) of the active keyframe's points in its axes.
        step: Number of the step; after the first one, which corrects the pose, other keyframes
            than the active one have to agree with the frame.

    Returns:
        (27,) sums as those of `accumulate`; None if the keyframe does not agree.
    """
    T_camera_keyframe = T_camera_active @ inverse(fit.T_keyframe_active)
    points, model = fit.keyframe.points[0], fit.residual_model
    motion = change_frame(motion, fit.T_keyframe_active)
    samples = sample_points(fit.keyframe.points, images, T_camera_keyframe, motion, 0)
    cell_weights = weigh_regions(points, samples, model, uniform_weights())
    weighted = weigh_samples(points, samples, cell_weights)
    for _ in range(INITIAL_MODEL_UPDATES if step == 0 else 1):
        model = fit_residual_model(points, weighted, model)
    fit.residual_model = model
    agrees = is_consistent(count_residuals(points, samples, model, cell_weights))
    if step > 0 and not fit.is_active and not agrees:
        return None
    sums: Array = accumulate(points, samples, weighted, model).sum(axis=0)
    return sums


def is_replaceable(tracked: TrackedFrame, local_map: LocalMap) -> bool:
    """Whether the keyframe of a frame can be replaced, by this frame or by another keyframe."""
    return _can_be_keyframe(tracked) or _find_near(tracked, local_map) is not None


def _can_be_keyframe(tracked: TrackedFrame) -> bool:
    """Whether enough of a frame's view is not occluded."""
    return occluded_fraction(tracked.result.alignment) <= MAX_OCCLUDED_SHARE


def _find_near(tracked: TrackedFrame, local_map: LocalMap) -> DirectKeyframe | None:
    """Another keyframe that is near enough to serve again."""
    result = tracked.result
    for other, overlap in local_map.rank_by_overlap(result.T_world_camera):
        if other is not result.keyframe and _has_large_overlap(overlap, MAX_REUSE_FLOW):
            return other
    return None


def select(tracked: TrackedFrame, local_map: LocalMap) -> DirectKeyframe:
    """Return a keyframe of the map that is near enough, or add the frame to the map."""
    result, alignment = tracked.result, tracked.result.alignment
    near = _find_near(tracked, local_map)
    if near is not None:
        local_map.move_to_newest(near)
        return near
    if not _can_be_keyframe(tracked):
        return result.keyframe
    keyframe = make_keyframe(
        tracked.frame,
        tracked.images,
        result.T_world_camera,
        alignment.camera_motion,
        alignment.is_static,
    )
    keyframe = remove_dynamic_points(keyframe, local_map.keyframes)
    if len(keyframe.points[0].brightness) < MIN_KEYFRAME_POINTS:
        return result.keyframe
    local_map.add(keyframe)
    return keyframe


def rebuild_first_keyframe(
    result: TrackingResult,
    images: ImagePyramid,
    is_static: NDArray[np.bool_],
) -> TrackingResult:
    """Rebuild the first keyframe by the velocity, and align the second frame with it again.

    Args:
        result: Alignment of the second frame with it.
        images: The second frame.
        is_static: (CELLS,) which cells of the image to take points from.
    """
    old = result.keyframe
    T_first_second = inverse(result.alignment.T_camera_keyframe)
    motion = constant_velocity_motion(se3_log(T_first_second) * result.prior.rate_hz)
    keyframe = make_keyframe(old.frame, old.images, old.T_world_keyframe, motion, is_static)
    alignment = align(
        keyframe.points,
        images,
        result.alignment.T_camera_keyframe,
        result.prior,
        images.brightness_ratio(old.images),
        uniform_weights(),
    )
    return TrackingResult(keyframe, alignment, result.prior)

"""Recovery: what is tried where a frame does not fit the keyframe, or may fit it by chance.

First half of the view is masked, where the motion is unexpected: it may follow an object. A near
object with much texture can be followed by a rotation: distant surfaces hardly move, and nearly all
of the view fits. If the object is in the masked half, the motion is that of the room. Then
keyframes are searched for by features, and the lighting is ignored if it has changed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from math import log
from weakref import WeakKeyDictionary

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import (
    IDENTITY_BRIGHTNESS,
    DirectAlignment,
    PointPyramid,
    align,
    depth_only_weights,
    uniform_weights,
)
from vo_service.odometry.direct.image_pyramid import CELL_COLUMNS, CELL_ROWS, ImagePyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, LocalMap, compute_overlap
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    FEATURE_INLIER_SHARES,
    HALF_VIEW_POINT_STRIDE,
    INNOVATION_COST_WEIGHT,
    INNOVATION_DEGREES_OF_FREEDOM,
    INNOVATION_GATE_SIGMAS,
    MAX_BRIGHTNESS_RATIO,
    MAX_FEATURE_MATCHES,
    MAX_RETRY_INTERVAL_FRAMES,
    MAX_SAME_MOTION_FLOW_PX,
    MAX_SEARCHED_KEYFRAMES,
    MIN_SCORE_GAIN,
    MIN_STATIC_WEIGHT,
    NUM_FINE_LEVELS,
    RETRY_INTERVAL_FRAMES,
)
from vo_service.odometry.direct.quality import (
    TrackingResult,
    rejection_reason,
    residual_score,
    strict_rejection_reason,
)
from vo_service.odometry.direct.residuals import (
    SIGMA_BRIGHTNESS,
    WITH_BRIGHTNESS,
    WITH_DEPTH,
    count_residuals,
    robust_cost,
    weigh_regions,
)
from vo_service.odometry.features import (
    FeatureView,
    GrayFrame,
    MatchVerifier,
    SurfParameters,
    backproject_features,
    match_features,
    pair_points,
    select_pairs_with_depth,
)
from vo_service.odometry.ransac import find_consensus, refine_rigid_motion
from vo_service.odometry.surf import SurfExtractor

# A match is only the initial guess of an alignment, which verifies it. A rolling shutter distorts
# the view, so that few of the feature matches agree with any one motion.
FEATURE_MATCH_VERIFIER = MatchVerifier(*FEATURE_INLIER_SHARES)
# Columns of cells that are masked: the left, middle and right half of the view.
MASKED_COLUMNS = tuple(
    slice(first, first + CELL_COLUMNS // 2) for first in (0, CELL_COLUMNS // 4, CELL_COLUMNS // 2)
)


def retry_without_half(
    result: TrackingResult, images: ImagePyramid, motion_state: MotionState
) -> TrackingResult:
    """Return the result, or another motion of a half masked view if it has the lower cost.

    The cost grows with the residuals of the whole view and with the innovation.

    Args:
        result: Alignment of the whole view.
        images: The frame.
        motion_state: The state up to the last good frame.
    """

    def innovation_ratio(alignment: DirectAlignment) -> float:
        return motion_state.innovation_ratio(alignment.camera_velocity, images.stamp_s)

    if innovation_ratio(result.alignment) < INNOVATION_GATE_SIGMAS:
        return result
    points = result.keyframe.points
    some_points = [np.asfortranarray(each[::HALF_VIEW_POINT_STRIDE]) for each in points]
    halves = [
        _align_without(half, some_points, result, images, motion_state) for half in MASKED_COLUMNS
    ]
    others = [half for half in halves if _is_other_motion(half, result)]
    if not others:
        return result

    def best(candidates: Sequence[DirectAlignment], points: Array) -> DirectAlignment:
        models = np.array([each.residual_model for each in candidates])
        sigmas = models.min(axis=0)[SIGMA_BRIGHTNESS:]
        return min(
            candidates,
            key=lambda each: (
                _mean_cost(points, each, sigmas)
                + INNOVATION_COST_WEIGHT
                * log(1 + innovation_ratio(each) ** 2 / INNOVATION_DEGREES_OF_FREEDOM)
            ),
        )

    other = _align_where_static(best(others, some_points[0]), some_points[0], result, images)
    if rejection_reason(other):
        return result
    return replace(result, alignment=best([result.alignment, other], points[0]))


def _align_without(
    masked_columns: slice,
    some_points: PointPyramid,
    result: TrackingResult,
    images: ImagePyramid,
    motion_state: MotionState,
) -> DirectAlignment:
    """Align some of the keyframe's points with half of the view."""
    weights = uniform_weights()
    weights.reshape(2, CELL_ROWS, CELL_COLUMNS)[:, :, masked_columns] = 0.0
    return align(
        some_points,
        images,
        motion_state.initial_guesses(result.keyframe.T_world_keyframe, images.stamp_s)[:1],
        result.prior,
        motion_state.predict_affine_brightness(images),
        weights,
    )


def _is_other_motion(alignment: DirectAlignment, result: TrackingResult) -> bool:
    """Whether an alignment moves the points of the result's keyframe elsewhere."""
    difference = inverse(result.alignment.T_camera_keyframe) @ alignment.T_camera_keyframe
    return compute_overlap(result.keyframe, difference).flow_px >= MAX_SAME_MOTION_FLOW_PX


def _align_where_static(
    half: DirectAlignment, some_points: Array, result: TrackingResult, images: ImagePyramid
) -> DirectAlignment:
    """Align all regions of the view that fit the motion of a half; that used `some_points`."""
    region_weights = weigh_regions(
        some_points, half.samples, half.residual_model, uniform_weights()
    )
    return align(
        result.keyframe.points[:NUM_FINE_LEVELS],
        images,
        [half.T_camera_keyframe],
        result.prior,
        half.affine_brightness,
        (region_weights >= MIN_STATIC_WEIGHT).astype(np.float64),
    )


def _mean_cost(points: Array, alignment: DirectAlignment, sigmas: Array) -> float:
    """Mean robust cost of a sample in the whole view, for given sigmas (2,) and weight."""
    residual_model = alignment.residual_model.copy()
    residual_model[SIGMA_BRIGHTNESS:] = sigmas
    counts = count_residuals(points, alignment.samples, residual_model, uniform_weights())
    sampled = counts[WITH_DEPTH] + counts[WITH_BRIGHTNESS]
    cost = robust_cost(points, alignment.samples, residual_model, uniform_weights())
    return float(cost / max(sampled, 1.0))


class DirectRecovery:
    """Recovery by features, and by depth alone."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.features = FeatureSearch(extractor)
        self._frames_to_retry = 0
        self._retry_interval = RETRY_INTERVAL_FRAMES

    def recover(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        initial: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> TrackingResult:
        """Return the initial alignment, or one that is clearly better.

        Args:
            frame: The frame.
            images: Its image pyramid.
            initial: Its alignment with the active keyframe.
            motion_state: The state up to the last good frame.
            local_map: The keyframes.
        """
        if rejection_reason(initial.alignment):
            self._retry_interval = RETRY_INTERVAL_FRAMES
            self._frames_to_retry = min(self._frames_to_retry, RETRY_INTERVAL_FRAMES)
        if self._frames_to_retry > 0 and not motion_state.is_stale(images.stamp_s):
            self._frames_to_retry -= 1
            result = (
                self._recover_by_depth(images, initial, motion_state)
                if rejection_reason(initial.alignment)
                else initial
            )
            if not rejection_reason(result.alignment):
                return result
        result = self._recover_by_features(frame, images, initial, motion_state, local_map)
        if rejection_reason(result.alignment):
            result = self._recover_by_depth(images, result, motion_state)
        has_failed = result is initial or bool(result.degradation)
        self._frames_to_retry = self._retry_interval if has_failed else 0
        self._retry_interval = (
            min(2 * self._retry_interval, MAX_RETRY_INTERVAL_FRAMES)
            if has_failed
            else RETRY_INTERVAL_FRAMES
        )
        return result

    def _recover_by_features(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        best: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> TrackingResult:
        """Align with matched keyframes: the active one first, then the most recently used."""
        others = [k for k in reversed(local_map.keyframes) if k is not best.keyframe]
        keyframes = [best.keyframe, *others][:MAX_SEARCHED_KEYFRAMES]
        for match in islice(self.features.find_matches(frame, keyframes), MAX_FEATURE_MATCHES):
            keyframe = match.keyframe
            prior = motion_state.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
            candidate = align(
                keyframe.points,
                images,
                [match.T_camera_keyframe],
                prior,
                (images.brightness_ratio(keyframe.images), 0.0),
                uniform_weights(),
            )
            if _is_better(candidate, best.alignment):
                best = TrackingResult(keyframe, candidate, prior)
            if not rejection_reason_after(candidate, motion_state, images):
                break
        return best

    def _recover_by_depth(
        self, images: ImagePyramid, best: TrackingResult, motion_state: MotionState
    ) -> TrackingResult:
        """Align without brightness where the lighting has changed, as in the dark.

        In unchanged light, a misfit of brightness means that the depth is wrong as well. If the
        camera may be anywhere, shapes alone are ambiguous: many places look alike.
        """
        keyframe, prior = best.keyframe, best.prior
        is_anywhere = not motion_state.is_recent(images.stamp_s)
        if is_anywhere or not has_lighting_changed(images.brightness_ratio(keyframe.images)):
            return best
        initial_guesses = motion_state.initial_guesses(keyframe.T_world_keyframe, images.stamp_s)
        candidate = align(
            keyframe.points,
            images,
            initial_guesses,
            prior,
            IDENTITY_BRIGHTNESS,
            depth_only_weights(),
        )
        if rejection_reason(candidate):
            return best
        return TrackingResult(
            keyframe,
            candidate,
            prior,
            degradation=f"depth only: {rejection_reason(best.alignment)}",
        )


def rejection_reason_after(
    alignment: DirectAlignment, motion_state: MotionState, images: ImagePyramid
) -> str:
    """Why an alignment is rejected; stricter if the last known pose is old.

    Args:
        alignment: Of a frame with a keyframe.
        motion_state: The state up to the last good frame.
        images: The frame.
    """
    return (
        rejection_reason(alignment)
        if motion_state.is_recent(images.stamp_s)
        else strict_rejection_reason(alignment)
    )


def has_lighting_changed(ratio: float) -> bool:
    """Whether a brightness ratio of two views means that the lighting has changed."""
    return abs(log(ratio)) > log(MAX_BRIGHTNESS_RATIO)


def _is_better(candidate: DirectAlignment, best: DirectAlignment) -> bool:
    if bool(rejection_reason(candidate)) != bool(rejection_reason(best)):
        return not rejection_reason(candidate)
    return residual_score(candidate) < (1.0 - MIN_SCORE_GAIN) * residual_score(best)


@dataclass(frozen=True)
class KeyframeMatch:
    """A keyframe in view, and the motion T_camera_keyframe (4x4) by features."""

    keyframe: DirectKeyframe
    T_camera_keyframe: Array


class FeatureSearch:
    """SURF features of a frame and of keyframes; those of a keyframe are cached."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.extractor = extractor
        self._parameters = SurfParameters()
        self._views: WeakKeyDictionary[DirectKeyframe, FeatureView] = WeakKeyDictionary()

    def find_matches(
        self, frame: RgbdFrame, keyframes: Sequence[DirectKeyframe]
    ) -> Iterator[KeyframeMatch]:
        """Yield the keyframes that enough features of a frame agree with, in their order."""
        view = self._make_view(frame)
        for keyframe in keyframes:
            if keyframe not in self._views:
                self._views[keyframe] = self._make_view(keyframe.frame)
            T_keyframe_camera = self._estimate_motion(view, self._views[keyframe])
            if T_keyframe_camera is not None:
                yield KeyframeMatch(keyframe, inverse(T_keyframe_camera))

    def _make_view(self, frame: RgbdFrame | GrayFrame) -> FeatureView:
        features = self.extractor.extract(frame.gray)
        self.extractor.release_buffers()  # it is used rarely
        return FeatureView(
            features, backproject_features(features, frame), frame.camera, frame.stamp_s
        )

    def _estimate_motion(self, view: FeatureView, reference: FeatureView) -> Array | None:
        """4x4 T_reference_camera; None if the features may agree by chance."""
        parameters = self._parameters
        pairs = match_features(view.features, reference.features, parameters.match_ratio)
        matches = pair_points(
            view.points, reference.points, select_pairs_with_depth(view, reference, pairs)
        )
        consensus = find_consensus(matches, parameters.max_hypotheses, parameters.seed)
        motion = refine_rigid_motion(consensus, matches)
        inliers = int(motion.inlier.sum())
        if inliers < parameters.min_inliers or not FEATURE_MATCH_VERIFIER.accepts(
            inliers, len(matches)
        ):
            return None
        return motion.T_reference_camera

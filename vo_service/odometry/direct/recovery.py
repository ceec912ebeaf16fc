"""Recovery: what is tried where a frame does not fit the keyframe, or may fit it by chance.

Keyframes are searched for by features; where the lighting has changed, brightness is ignored.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import log
from weakref import WeakKeyDictionary

import numpy as np

from drivers.camera import PosePrior, RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.depth_grid import DepthGrid
from vo_service.odometry.direct.alignment import (
    align,
    depth_only_weights,
    uniform_weights,
)
from vo_service.odometry.direct.covariance import estimate_uncertainty
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, LocalMap
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    MAX_BRIGHTNESS_RATIO,
    MAX_SEARCHED_KEYFRAMES,
    MAX_SQUARED_POSE_DIFFERENCE,
    MIN_DISTANT_OBSERVABILITY,
)
from vo_service.odometry.direct.quality import (
    TrackingResult,
    is_suspect,
    rejection_reason,
)
from vo_service.odometry.features import verification
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.odometry.features.gray_frame import GrayFrame
from vo_service.odometry.features.match_verifier import GUESS_VERIFIER, LAST_VIEW_VERIFIER
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.features.points import backproject_features, pair_points
from vo_service.odometry.features.views import FeatureView, match_views


@dataclass(frozen=True)
class KeyframeMatch:
    """A keyframe in view, by features.

    Attributes:
        keyframe: The keyframe.
        T_camera_keyframe: 4x4 motion.
        covariance: 6x6 of T_keyframe_camera, (translation m, rotation rad) as a small motion in the
            camera's axes; None if the motion is only an initial guess.
    """

    keyframe: DirectKeyframe
    T_camera_keyframe: Array
    covariance: Array | None

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose of the camera."""
        return self.keyframe.T_world_keyframe @ inverse(self.T_camera_keyframe)

    @property
    def information(self) -> Array:
        """6x6 inverse of the covariance; zero without one."""
        if self.covariance is None:
            return np.zeros((6, 6))
        return np.asarray(np.linalg.inv(self.covariance), np.float64)

    def agrees(self, result: TrackingResult) -> bool:
        """Whether an alignment has led to the same pose."""
        if self.covariance is None:
            return False
        T_found_aligned = inverse(self.T_world_camera) @ result.T_world_camera
        difference = se3_log(np.ascontiguousarray(T_found_aligned))
        squared = float(difference @ self.information @ difference)
        return squared < MAX_SQUARED_POSE_DIFFERENCE


class DirectRecovery:
    """Recovery by features, and by depth alone."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.features = FeatureSearch(extractor)

    def recover(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        initial: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> tuple[TrackingResult, KeyframeMatch | None]:
        """Return the initial alignment, or one that is clearly better.

        Args:
            frame: The frame.
            images: Its image pyramid.
            initial: Its alignment with the active keyframe.
            motion_state: The state up to the last good frame.
            local_map: The keyframes.

        Returns:
            The result, and the match of features that is believed, if any.
        """
        result = self._recover_from_rest(images, initial, motion_state)
        result, match = self._recover_by_features(frame, images, result, motion_state, local_map)
        if rejection_reason(result.alignment):
            result = self._recover_by_depth(images, result, motion_state)
        return result, match

    def tell_motion(
        self,
        frame: RgbdFrame,
        motion_state: MotionState,
        active: DirectKeyframe,
        local_map: LocalMap,
    ) -> RgbdFrame | None:
        """Return a frame with what its features tell of the motion; None if no match is believed.

        Args:
            frame: The frame.
            motion_state: The state up to the last good frame.
            active: The keyframe whose features are compared first.
            local_map: The keyframes.
        """
        matches = self.features.find_matches(frame, _searched_keyframes(active, local_map))
        match = next((each for each in matches if each.covariance is not None), None)
        if match is None or _is_at_rest_in_view(match, motion_state, frame.stamp_s):
            return None
        T_last_camera = inverse(motion_state.T_world_camera) @ match.T_world_camera
        before = frame.pose_prior
        of_floor = np.zeros((6, 6)) if before is None else before.floor_information
        prior = PosePrior(T_last_camera, match.information + of_floor, of_floor, "features")
        return replace(frame, pose_prior=prior)

    def _recover_from_rest(
        self, images: ImagePyramid, best: TrackingResult, motion_state: MotionState
    ) -> TrackingResult:
        """Align from the last pose as well, where the velocity predicts little."""
        keyframe = best.keyframe
        candidate = align(
            keyframe.points,
            images,
            motion_state.resting_alignment(keyframe.T_world_keyframe),
            best.prior,
            images.brightness_ratio(keyframe.images),
            uniform_weights(),
        )
        return _better(TrackingResult(keyframe, candidate, best.prior), best)

    def _recover_by_features(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        best: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> tuple[TrackingResult, KeyframeMatch | None]:
        """Align with the keyframes that match."""
        believed = None
        keyframes = _searched_keyframes(best.keyframe, local_map)
        for match in self.features.find_matches(frame, keyframes):
            keyframe = match.keyframe
            prior = motion_state.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
            candidate = align(
                keyframe.points,
                images,
                match.T_camera_keyframe,
                prior,
                images.brightness_ratio(keyframe.images),
                uniform_weights(),
            )
            result = TrackingResult(keyframe, candidate, prior)
            best = _better(result, best)
            is_accepted = not rejection_reason_after(best, motion_state, images, match)
            # The one that has confirmed the alignment, else the first one that is believed.
            if match.covariance is not None and (believed is None or is_accepted):
                believed = match
            if is_accepted:
                break
        return best, believed

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
        is_stale = motion_state.is_stale(images.stamp_s)
        candidate = align(
            keyframe.points,
            images,
            motion_state.resting_alignment(keyframe.T_world_keyframe)
            if is_stale
            else motion_state.predict_alignment(keyframe.T_world_keyframe, images.stamp_s),
            prior,
            1.0,
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


def _searched_keyframes(active: DirectKeyframe, local_map: LocalMap) -> list[DirectKeyframe]:
    """The active keyframe, then the last used ones."""
    others = [each for each in reversed(local_map.keyframes) if each is not active]
    return [active, *others][:MAX_SEARCHED_KEYFRAMES]


def _is_at_rest_in_view(match: KeyframeMatch, motion_state: MotionState, stamp_s: float) -> bool:
    """Whether features are at rest though the camera was moving: they may be on the robot."""
    elapsed_s = stamp_s - motion_state.well_constrained_stamp_s
    seen, expected = (
        float(motion @ match.information @ motion)
        for motion in (se3_log(match.T_camera_keyframe), elapsed_s * motion_state.velocity)
    )
    return seen < MAX_SQUARED_POSE_DIFFERENCE < expected


def rejection_reason_after(
    result: TrackingResult,
    motion_state: MotionState,
    images: ImagePyramid,
    match: KeyframeMatch | None = None,
) -> str:
    """Why an alignment is rejected; stricter if the last known pose is old.

    Args:
        result: Alignment of a frame with a keyframe.
        motion_state: The state up to the last good frame.
        images: The frame.
        match: Of its features, which may confirm the alignment.
    """
    reason = rejection_reason(result.alignment)
    if reason or not motion_state.is_stale(images.stamp_s):
        return reason
    if match is not None and match.agrees(result):
        return ""
    if is_suspect(result.alignment):
        return "the keyframe fits badly: the camera may be elsewhere"
    uncertainty = estimate_uncertainty(
        result.keyframe.points, images, result.alignment, result.prior, np.zeros(2)
    )
    if uncertainty.observability < MIN_DISTANT_OBSERVABILITY:
        return "degenerate view: the camera may be elsewhere along a surface"
    return ""


def has_lighting_changed(ratio: float) -> bool:
    """Whether a brightness ratio of two views means that the lighting has changed."""
    return abs(log(ratio)) > log(MAX_BRIGHTNESS_RATIO)


def _better(a: TrackingResult, b: TrackingResult) -> TrackingResult:
    """Return the valid one of two results, or the more likely one."""
    return min(b, a, key=lambda r: (bool(rejection_reason(r.alignment)), r.negative_log_likelihood))


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
            match = self._match(view, keyframe, self._views[keyframe])
            if match is not None:
                yield match

    def _make_view(self, frame: RgbdFrame | GrayFrame) -> FeatureView:
        features = self.extractor.extract(frame.gray)
        self.extractor.release_buffers()  # it is used rarely
        return FeatureView(
            features,
            backproject_features(features, frame),
            frame.camera,
            frame.stamp_s,
            DepthGrid.of(frame.depth_m, frame.camera),
        )

    def _match(
        self, view: FeatureView, keyframe: DirectKeyframe, reference: FeatureView
    ) -> KeyframeMatch | None:
        """Match a keyframe; None if the features may agree by chance."""
        parameters = self._parameters
        matches = match_views(view, reference, parameters.match_ratio)
        pairs = pair_points(view.points, reference.points, matches)
        motion = verification.estimate_motion(pairs, parameters)
        if not verification.is_beyond_chance(motion, GUESS_VERIFIER, parameters):
            return None
        T_camera_keyframe = inverse(motion.T_reference_camera)
        if verification.rejection_reason(view, reference, motion, LAST_VIEW_VERIFIER, parameters):
            return KeyframeMatch(keyframe, T_camera_keyframe, None)
        motion = verification.cover_doubt(motion, pairs, parameters)
        return KeyframeMatch(keyframe, T_camera_keyframe, motion.covariance)

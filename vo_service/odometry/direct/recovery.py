"""Recovery of a frame that does not fit the keyframe, or may fit it by chance."""

from dataclasses import dataclass, replace
from itertools import islice
from math import log

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, adjoint, inverse
from vo_service.odometry.direct.alignment import (
    DirectAlignment,
    MotionPrior,
    align,
    depth_only_weights,
    uniform_weights,
)
from vo_service.odometry.direct.feature_search import FeatureSearch
from vo_service.odometry.direct.image_pyramid import ImagePyramid
from vo_service.odometry.direct.local_map import DirectKeyframe, LocalMap
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    MAX_BRIGHTNESS_RATIO,
    MAX_FEATURE_MATCHES,
    MAX_SEARCHED_KEYFRAMES,
    MIN_SCORE_GAIN,
    RETRY_INTERVAL_FRAMES,
)
from vo_service.odometry.direct.quality import (
    outlier_score,
    rejection_reason,
    residual_score,
    strict_rejection_reason,
)
from vo_service.odometry.direct.rolling_shutter import ACCELERATION_START
from vo_service.odometry.surf import SurfExtractor


@dataclass(frozen=True)
class TrackingResult:
    """Alignment of a frame with a keyframe.

    Attributes:
        keyframe: The keyframe that the frame is aligned with.
        alignment: The motion and its residuals.
        prior: What was known of the motion.
        degradation: What the alignment lacks; "" for nothing.
    """

    keyframe: DirectKeyframe
    alignment: DirectAlignment
    prior: MotionPrior
    degradation: str = ""

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose of the camera."""
        return self.keyframe.T_world_keyframe @ inverse(self.alignment.T_camera_keyframe)

    def with_pose(self, T_world_camera: Array, velocity: Array) -> "TrackingResult":
        """Return a copy with another pose (4x4) and velocity (6,), in the camera's own axes."""
        T_camera_keyframe = inverse(T_world_camera) @ self.keyframe.T_world_keyframe
        motion = self.alignment.motion.copy()
        motion[:ACCELERATION_START] = -adjoint(inverse(T_camera_keyframe)) @ velocity
        moved = replace(self.alignment, T_camera_keyframe=T_camera_keyframe, motion=motion)
        return replace(self, alignment=moved)

    @property
    def needs_recovery(self) -> bool:
        """Whether the alignment is doubtful or invalid."""
        return outlier_score(self.alignment) > 1.0 or bool(rejection_reason(self.alignment))


class DirectRecovery:
    """Recovery by features, and by depth alone."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.features = FeatureSearch(extractor)
        self._frames_to_retry = 0

    def recover(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        initial: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> TrackingResult:
        """Return the initial alignment, or one that is clearly better."""
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
        self._frames_to_retry = RETRY_INTERVAL_FRAMES if has_failed else 0
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
            keyframe.points, images, initial_guesses, prior, (1.0, 0.0), depth_only_weights()
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
    """Why an alignment is rejected; stricter if the last known pose is old."""
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

"""What else is tried with a frame that does not fit the keyframe, or may fit it by chance."""

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
    FAILURE_LIMITS_FRAMES,
    KEYFRAME_COUNTS,
    MAX_BRIGHTNESS_RATIO,
    SLIGHT,
)
from vo_service.odometry.direct.quality import (
    outlier_score,
    rejection_reason,
    residual_score,
    strict_rejection_reason,
)
from vo_service.odometry.direct.rolling_shutter import ACCELERATION_START
from vo_service.odometry.surf import SurfExtractor

# So many are searched for features, and so many that are found are followed up: a thing that moves
# may be seen in the best of them.
_, MAX_FEATURE_MATCHES, MAX_SEARCHED_KEYFRAMES, _ = KEYFRAME_COUNTS
# After a try that changed nothing, so many odd frames are taken as they are.
RETRY_INTERVAL_FRAMES = FAILURE_LIMITS_FRAMES[0]


@dataclass(frozen=True)
class TrackingResult:
    """An alignment, of which keyframe, and what it had to do without ("" = nothing)."""

    keyframe: DirectKeyframe
    alignment: DirectAlignment
    prior: MotionPrior
    degradation: str = ""

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose of the camera."""
        return self.keyframe.T_world_keyframe @ inverse(self.alignment.T_camera_keyframe)

    def with_pose(self, T_world_camera: Array, velocity: Array) -> "TrackingResult":
        """The same with another pose (4x4) and velocity (6,) of the camera in its own axes."""
        T_camera_keyframe = inverse(T_world_camera) @ self.keyframe.T_world_keyframe
        movement = self.alignment.motion.copy()
        movement[:ACCELERATION_START] = -adjoint(inverse(T_camera_keyframe)) @ velocity
        moved = replace(self.alignment, T_camera_keyframe=T_camera_keyframe, motion=movement)
        return replace(self, alignment=moved)

    @property
    def needs_recovery(self) -> bool:
        """Whether it is odd or not to be believed."""
        return outlier_score(self.alignment) > 1.0 or bool(rejection_reason(self.alignment))


class DirectRecovery:
    """Two more ways: features, and depth alone."""

    def __init__(self, extractor: SurfExtractor) -> None:
        self.features = FeatureSearch(extractor)
        self._frames_to_retry = 0

    def recover(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        first: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> TrackingResult:
        """The first try, or what is clearly better."""
        if self._frames_to_retry > 0 and not motion_state.is_stale(images.stamp_s):
            self._frames_to_retry -= 1
            found = (
                self._recover_by_depth(images, first, motion_state)
                if rejection_reason(first.alignment)
                else first
            )
            if not rejection_reason(found.alignment):
                return found
        found = self._recover_by_features(frame, images, first, motion_state, local_map)
        if rejection_reason(found.alignment):
            found = self._recover_by_depth(images, found, motion_state)
        self._frames_to_retry = RETRY_INTERVAL_FRAMES if found is first or found.degradation else 0
        return found

    def _recover_by_features(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        best: TrackingResult,
        motion_state: MotionState,
        local_map: LocalMap,
    ) -> TrackingResult:
        """The keyframe in use first, then those that were in use last."""
        others = [k for k in reversed(local_map.keyframes) if k is not best.keyframe]
        keyframes = [best.keyframe, *others][:MAX_SEARCHED_KEYFRAMES]
        for sighting in islice(self.features.find_matches(frame, keyframes), MAX_FEATURE_MATCHES):
            keyframe = sighting.keyframe
            tie = motion_state.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
            start, light = (
                sighting.T_camera_keyframe,
                (images.brightness_ratio(keyframe.images), 0.0),
            )
            again = align(keyframe.points, images, [start], tie, light, uniform_weights())
            if _is_better(again, best.alignment):
                best = TrackingResult(keyframe, again, tie)
            if not rejection_reason_after(again, motion_state, images):
                break
        return best

    def _recover_by_depth(
        self, images: ImagePyramid, best: TrackingResult, motion_state: MotionState
    ) -> TrackingResult:
        """Without brightness, where the light is quite another: it may be dark.

        In the same light, brightness that does not fit says that the depth is wrong as well. Where
        the camera may be anywhere by now, shapes alone say little: many places have the same.
        """
        keyframe, tie = best.keyframe, best.prior
        is_anywhere = not motion_state.is_recent(images.stamp_s)
        if is_anywhere or not has_lighting_changed(images.brightness_ratio(keyframe.images)):
            return best
        starts = motion_state.initial_guesses(keyframe.T_world_keyframe, images.stamp_s)
        again = align(keyframe.points, images, starts, tie, (1.0, 0.0), depth_only_weights())
        if rejection_reason(again):
            return best
        return TrackingResult(
            keyframe, again, tie, degradation=f"by depth alone: {rejection_reason(best.alignment)}"
        )


def rejection_reason_after(
    alignment: DirectAlignment, motion_state: MotionState, images: ImagePyramid
) -> str:
    """Why an alignment is not to be believed, by how long ago it was known where the camera is."""
    return (
        rejection_reason(alignment)
        if motion_state.is_recent(images.stamp_s)
        else strict_rejection_reason(alignment)
    )


def has_lighting_changed(ratio: float) -> bool:
    """Whether one view is so many times as bright as another that the light must have changed."""
    return abs(log(ratio)) > log(MAX_BRIGHTNESS_RATIO)


def _is_better(candidate: DirectAlignment, best: DirectAlignment) -> bool:
    if bool(rejection_reason(candidate)) != bool(rejection_reason(best)):
        return not rejection_reason(candidate)
    return residual_score(candidate) < (1.0 - SLIGHT) * residual_score(best)

"""Dense odometry against keyframes: the brightness and depth of a frame, laid on those of another.

Kerl, Sturm and Cremers, "Dense Visual SLAM for RGB-D Cameras" (IROS 2013) for the keyframes; Kerl,
Stueckler and Cremers, "Dense Continuous-Time Tracking and Mapping with Rolling Shutter RGB-D
Cameras" (ICCV 2015) for the time of each row. SURF finds the camera again where that fails.
"""

from dataclasses import dataclass

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import STATIC_PRIOR, align, uniform_weights
from vo_service.odometry.direct.covariance import MotionUncertainty, estimate_uncertainty
from vo_service.odometry.direct.degenerate_view import fuse_with_prediction
from vo_service.odometry.direct.grid import ALL_STATIC
from vo_service.odometry.direct.half_view_retry import retry_without_half
from vo_service.odometry.direct.image_pyramid import ImagePyramid, build_image_pyramid
from vo_service.odometry.direct.keyframe_init import reinitialize
from vo_service.odometry.direct.keyframe_selection import needs_keyframe, refine, select
from vo_service.odometry.direct.local_map import DirectKeyframe, LocalMap, make_keyframe
from vo_service.odometry.direct.motion_state import IDENTITY_BRIGHTNESS, MotionState
from vo_service.odometry.direct.parameters import FAILURE_LIMITS_FRAMES, MIN_POINTS
from vo_service.odometry.direct.pose_filter import alpha_beta_filter
from vo_service.odometry.direct.quality import (
    degradation_reason,
    occlusion_reason,
    rejection_reason,
)
from vo_service.odometry.direct.recovery import (
    DirectRecovery,
    TrackingResult,
    rejection_reason_after,
)
from vo_service.odometry.direct.rolling_shutter import zero_motion
from vo_service.odometry.direct.tracked_frame import TrackedFrame
from vo_service.odometry.direct.vignetting import VignettingEstimate
from vo_service.odometry.direct.visualization import make_tracking_debug, project_keyframe_points
from vo_service.odometry.profiling import NullStageTimer, StageTimer
from vo_service.odometry.surf import SurfExtractor
from vo_service.types import Estimate, TrackingDebug

# After so many frames without a pose, tracking begins anew; after fewer where none has been laid on
# the first keyframe yet, which a fast turn may have bent.
MAX_INITIAL_FAILURES, MAX_FAILURES = FAILURE_LIMITS_FRAMES


@dataclass(frozen=True)
class DirectTrack:
    """What is followed: a keyframe, and the way of the camera up to the last good frame.

    T_world_reference  4x4 pose of the frame from which on the keyframe has been in use
    is_first           the keyframe is the very first frame, and the camera's velocity not known
    last               the last good frame, from the second on
    clarity            of the keyframe's first view, see `Certainty`; None before that
    """

    keyframe: DirectKeyframe
    motion_state: MotionState
    T_world_reference: Array
    is_first: bool = False
    last_frame: TrackedFrame | None = None
    initial_observability: float | None = None

    def observability_at_start(
        self, result: TrackingResult, uncertainty: MotionUncertainty
    ) -> float:
        """Of the first view of the keyframe that was found: this one, if it was not in use."""
        if self.initial_observability is None or result.keyframe is not self.keyframe:
            return uncertainty.observability
        return self.initial_observability


class DirectOdometry:
    """Frames are laid on a keyframe, which stays as long as most of it is in view.

    World is the first good camera. A frame that fails is left out.
    """

    def __init__(
        self, extractor: SurfExtractor | None = None, timer: StageTimer | None = None
    ) -> None:
        self._timer = timer or NullStageTimer()
        self._recovery = DirectRecovery(extractor or SurfExtractor())
        self._map = LocalMap()
        self._vignetting = VignettingEstimate()
        self._track: DirectTrack | None = None
        self._T_world_camera = np.eye(4)
        self._failures = 0

    @property
    def vignetting(self) -> float:
        """Of the lens's light towards the corners, as it is known now: see `VignettingEstimate`."""
        return self._vignetting.value

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Where the camera is, from this frame and the keyframe."""
        # Brightness in four sizes, and inverse depth.
        with self._timer.stage("images"):
            images = build_image_pyramid(frame, self.vignetting)
        if self._track is None:
            return self._start(frame, images, is_reset=False)
        # The keyframe's points, laid on this frame from where they are expected.
        with self._timer.stage("align"):
            found = self._align(images, self._track)
        # Does it fit, and was it expected there? Else features, depth alone.
        if found.needs_recovery or self._track.motion_state.is_stale(images.stamp_s):
            with self._timer.stage("recovery"):
                found = self._recovery.recover(
                    frame, images, found, self._track.motion_state, self._map
                )
        # The shutter bent a first keyframe, while the velocity was not known: now it is.
        found = self._reinitialize_first_keyframe(images, found, self._track)
        if reason := rejection_reason_after(
            found.alignment, self._track.motion_state, images
        ) or occlusion_reason(found.alignment):
            return self._fail(frame, images, self._track, found, reason)
        # Does what is in view hold the camera in all six directions?
        with self._timer.stage("certainty"):
            agitation = self._track.motion_state.update_velocity_noise(
                found.alignment.camera_velocity
            )
            sure = estimate_uncertainty(
                found.keyframe.points, images, found.alignment, found.prior, agitation
            )
        if sure.rejection_reason:
            if not self._track.motion_state.is_recently_constrained(images.stamp_s):
                return self._fail(frame, images, self._track, found, sure.rejection_reason)
            # For a moment, it goes on as it moved.
            found, sure = fuse_with_prediction(
                found, sure, self._track.motion_state, images.stamp_s
            )
        elif self._track.motion_state.is_extrapolated:
            # From there to where it is found is no way that the camera went.
            found = found.with_pose(found.T_world_camera, self._track.motion_state.velocity)
        # A calm camera's pose is that of many frames.
        found, unrest = alpha_beta_filter(
            found, sure.covariance, self._track.motion_state, images.stamp_s
        )
        # When the keyframe goes out of view, the pose is settled with others, and the next begins.
        good = TrackedFrame(
            frame,
            images,
            found,
            self._track.motion_state,
            is_well_constrained=not sure.rejection_reason,
        )
        keyframe = found.keyframe
        if needs_keyframe(
            good, sure.observability, self._track.observability_at_start(found, sure)
        ):
            self._vignetting = self._vignetting.update(keyframe, images, found.alignment)
            good = good.with_vignetting(self.vignetting)
            with self._timer.stage("settle"):
                settled, good = refine(self._track.last_frame, good, self._map)
            with self._timer.stage("keyframe"):
                keyframe = select(settled, self._map)
        return self._advance(self._track, good, sure, keyframe, unrest)

    def _align(self, images: ImagePyramid, track: DirectTrack) -> TrackingResult:
        keyframe, way = track.keyframe, track.motion_state
        starts = way.initial_guesses(keyframe.T_world_keyframe, images.stamp_s)
        tie = way.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
        light = way.predict_affine_brightness(images)
        found = TrackingResult(
            keyframe, align(keyframe.points, images, starts, tie, light, uniform_weights()), tie
        )
        return found if track.is_first else retry_without_half(found, images, way)

    def _reinitialize_first_keyframe(
        self, images: ImagePyramid, result: TrackingResult, track: DirectTrack
    ) -> TrackingResult:
        """The same; on the first keyframe of a rolling shutter, made anew by the velocity."""
        if not track.is_first or images.shutter.is_instant or rejection_reason(result.alignment):
            return result
        result = reinitialize(result, images, track.motion_state)
        self._map.reset(result.keyframe)
        return result

    def _start(self, frame: RgbdFrame, images: ImagePyramid, is_reset: bool) -> Estimate:
        """Make this frame the first keyframe, if it has enough points to be laid on others."""
        keyframe = make_keyframe(frame, images, self._T_world_camera, zero_motion(), ALL_STATIC)
        evidence = TrackingDebug(keypoints_px=project_keyframe_points(keyframe))
        if reason := self._start_rejection_reason(keyframe, images):
            return self._make_estimate(False, f"cannot start: {reason}", evidence)
        self._map.reset(keyframe)
        way = MotionState(
            self._T_world_camera,
            np.zeros(6),
            images.stamp_s,
            IDENTITY_BRIGHTNESS,
            images.mean_brightness,
            well_constrained_stamp_s=images.stamp_s,
        )
        self._track = DirectTrack(keyframe, way, self._T_world_camera, is_first=True)
        self._failures = 0
        return self._make_estimate(True, "", evidence, is_reset=is_reset)

    def _start_rejection_reason(self, keyframe: DirectKeyframe, images: ImagePyramid) -> str:
        """Why a frame is no good first keyframe: the next ones could not be laid on it."""
        if len(keyframe.points[0]) < 2 * MIN_POINTS:
            return f"only {len(keyframe.points[0])} points with depth"
        itself = align(
            keyframe.points,
            images,
            [np.eye(4)],
            STATIC_PRIOR,
            IDENTITY_BRIGHTNESS,
            uniform_weights(),
        )
        return (
            rejection_reason(itself)
            or estimate_uncertainty(
                keyframe.points, images, itself, STATIC_PRIOR, np.zeros(2)
            ).rejection_reason
        )

    def _fail(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        track: DirectTrack,
        result: TrackingResult,
        reason: str,
    ) -> Estimate:
        """Hold the pose; after too many failures give the keyframes up."""
        self._failures += 1
        if self._failures > (MAX_INITIAL_FAILURES if track.is_first else MAX_FAILURES):
            return self._start(frame, images, is_reset=True)
        return self._make_estimate(
            False, reason, make_tracking_debug(result.keyframe, result.alignment)
        )

    def _advance(
        self,
        track: DirectTrack,
        tracked: TrackedFrame,
        uncertainty: MotionUncertainty,
        keyframe: DirectKeyframe,
        normalized_innovation: float,
    ) -> Estimate:
        """Go on from here, with this keyframe."""
        images, found = tracked.images, tracked.result
        is_next_reference = keyframe is not track.keyframe
        way = track.motion_state.advance(
            found.T_world_camera,
            found.alignment.camera_velocity,
            images,
            found.alignment.affine_brightness
            if keyframe is found.keyframe
            else IDENTITY_BRIGHTNESS,
            normalized_innovation,
            images.stamp_s
            if tracked.is_well_constrained
            else track.motion_state.well_constrained_stamp_s,
        )
        T_reference_camera = inverse(track.T_world_reference) @ found.T_world_camera
        T_world_reference = found.T_world_camera if is_next_reference else track.T_world_reference
        self._T_world_camera = found.T_world_camera
        clarity = (
            track.observability_at_start(found, uncertainty) if keyframe is found.keyframe else None
        )
        self._track = DirectTrack(
            keyframe, way, T_world_reference, last_frame=tracked, initial_observability=clarity
        )
        self._failures = 0
        return self._make_estimate(
            True,
            found.degradation or degradation_reason(found.alignment),
            make_tracking_debug(found.keyframe, found.alignment),
            T_reference_camera,
            uncertainty.covariance,
            is_next_reference=is_next_reference,
        )

    def _make_estimate(
        self,
        ok: bool,
        reason: str,
        debug: TrackingDebug,
        T_reference_camera: Array | None = None,
        covariance: Array | None = None,
        is_reset: bool = False,
        is_next_reference: bool = True,
    ) -> Estimate:
        return Estimate(
            ok=ok,
            reason=reason,
            T_world_camera=self._T_world_camera.copy(),
            T_reference_camera=np.eye(4) if T_reference_camera is None else T_reference_camera,
            covariance=np.zeros((6, 6)) if covariance is None else covariance,
            features=len(debug.keypoints_px),
            matches=len(debug.matches_px),
            inliers=int(debug.inlier.sum()),
            is_reset=is_reset,
            is_next_reference=is_next_reference,
            debug=debug,
        )

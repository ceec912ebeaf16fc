"""Direct RGB-D odometry: frames are aligned with keyframes by brightness and depth.

Kerl, Sturm and Cremers, "Dense Visual SLAM for RGB-D Cameras" (IROS 2013) for the keyframes; Kerl,
Stueckler and Cremers, "Dense Continuous-Time Tracking and Mapping with Rolling Shutter RGB-D
Cameras" (ICCV 2015) for the time of each row. SURF features recover the pose where that fails.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from drivers.camera import PosePrior, RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import (
    STATIC_PRIOR,
    align,
    uniform_weights,
)
from vo_service.odometry.direct.brightness import BrightnessWeight, VignettingEstimate
from vo_service.odometry.direct.covariance import MotionUncertainty, estimate_uncertainty
from vo_service.odometry.direct.depth_noise import DepthNoise
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, ImagePyramid, build_image_pyramid
from vo_service.odometry.direct.keyframe import DirectKeyframe, LocalMap, make_keyframe
from vo_service.odometry.direct.keyframe_selection import (
    TrackedFrame,
    is_replaceable,
    needs_keyframe,
    rebuild_first_keyframe,
    refine,
    select,
)
from vo_service.odometry.direct.motion import constant_velocity_motion, se3_log, zero_motion
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.parameters import (
    MAX_FAILURES,
    MAX_LOST_S,
    MAX_PREDICTION_S,
    MIN_KEYFRAME_POINTS,
    POINT_BLOCKS,
    REINITIALIZATIONS,
)
from vo_service.odometry.direct.pose_filter import (
    contradiction_reason,
    fuse_with_prediction,
    information_of_prediction,
)
from vo_service.odometry.direct.quality import (
    TrackingResult,
    degradation_reason,
    make_tracking_debug,
    occlusion_reason,
    project_keyframe_points,
    rejection_reason,
)
from vo_service.odometry.direct.recovery import (
    DirectRecovery,
    KeyframeMatch,
    rejection_reason_after,
)
from vo_service.odometry.direct.robot_body import RobotBody
from vo_service.odometry.direct.small_matrices import invert_cholesky
from vo_service.odometry.features.extractor import SurfExtractor
from vo_service.types.estimate import Estimate, TrackingDebug
from vo_service.types.odometry import ImmediateWork, NullStageTimer, StageTimer, WorkQueue


@dataclass(frozen=True)
class DirectTrack:
    """State of the tracking up to the last good frame.

    Attributes:
        keyframe: The active keyframe.
        motion_state: Pose and velocity at the last good frame.
        T_world_reference: 4x4 pose of the frame since which the keyframe is active.
        is_first: Whether the keyframe is the first frame, so that the velocity is unknown.
        last_frame: The last good frame; None at the first one.
    """

    keyframe: DirectKeyframe
    motion_state: MotionState
    T_world_reference: Array
    is_first: bool = False
    last_frame: TrackedFrame | None = None

    def with_pose_prior(self, pose_prior: PosePrior | None) -> "DirectTrack":
        """Return a copy with what else tells of the next frame's pose."""
        motion_state = self.motion_state.with_pose_prior(pose_prior)
        return (
            self if motion_state is self.motion_state else replace(self, motion_state=motion_state)
        )


class DirectOdometry:
    """Odometry that aligns frames with a keyframe, as long as most of it is in view.

    The world frame is the first good camera pose. A frame that fails is skipped.

    Args:
        extractor: Features for the recovery; a default one if None.
        timer: Times the stages; not timed if None.
        point_blocks: Numbers of blocks for a keyframe's points by level, see `ImagePyramid`.
        deferred: Takes the selection of keyframes; it is done at once if None.
    """

    def __init__(
        self,
        extractor: SurfExtractor | None = None,
        timer: StageTimer | None = None,
        point_blocks: Sequence[int] = POINT_BLOCKS,
        deferred: WorkQueue | None = None,
    ) -> None:
        self._point_blocks = point_blocks
        self._timer = timer or NullStageTimer()
        self._deferred = deferred or ImmediateWork()
        self._recovery = DirectRecovery(extractor or SurfExtractor())
        self._map = LocalMap()
        self._vignetting = VignettingEstimate()
        self._brightness_weight = BrightnessWeight()
        self._depth_noise = DepthNoise()
        self._body = RobotBody()
        self._track: DirectTrack | None = None
        self._T_world_camera = np.eye(4)
        self._failures = 0
        self._stamp_s = np.inf

    @property
    def vignetting(self) -> float:
        """Current estimate of the lens's vignetting, see `VignettingEstimate`."""
        return self._vignetting.value

    @property
    def last_frame(self) -> TrackedFrame | None:
        """The last good frame that was aligned; None at the start."""
        return self._track.last_frame if self._track else None

    @property
    def velocity(self) -> Array:
        """(6,) twist of the camera at the last good frame, in its own axes, m/s and rad/s."""
        return self._track.motion_state.velocity if self._track else np.zeros(6)

    @property
    def well_constrained_stamp_s(self) -> float:
        """Stamp of the last frame that constrained all degrees of freedom; -inf at the start."""
        return self._track.motion_state.well_constrained_stamp_s if self._track else -np.inf

    @property
    def T_world_camera(self) -> Array:
        """4x4 pose of the last good frame."""
        return self._T_world_camera

    @property
    def keyframes(self) -> Sequence[DirectKeyframe]:
        """The keyframes, the most recently used one last."""
        return self._map.keyframes

    @property
    def active_keyframe(self) -> DirectKeyframe | None:
        """The keyframe that the next frame is aligned with; None before the first one."""
        return self._track.keyframe if self._track else None

    def continue_from(
        self,
        keyframes: Sequence[DirectKeyframe],
        active: DirectKeyframe,
        motion_state: MotionState | None = None,
        is_reference: bool = False,
    ) -> None:
        """Go on with other keyframes of the same world, after the first frame.

        Args:
            keyframes: All keyframes, the most recently used one last.
            active: The one of them that the next frame is aligned with.
            motion_state: Another one at the last frame; None for the same.
            is_reference: Whether that frame is the reference of the next motion.
        """
        assert self._track is not None
        self._map.keyframes = list(keyframes)
        self._track = replace(self._track, keyframe=active)
        if motion_state is not None:
            self._T_world_camera, self._failures = motion_state.T_world_camera, 0
            reference = self._T_world_camera if is_reference else self._track.T_world_reference
            self._track = DirectTrack(active, motion_state, reference)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose by aligning this frame with the keyframe.

        The steps are those of docs/design/direct.md, in the same order.
        """
        # Pyramid: brightness in several sizes, and inverse depth.
        with self._timer.stage("images"):
            images = build_image_pyramid(
                frame,
                self.vignetting,
                self._brightness_weight.value,
                self._depth_noise.value_per_m,
                self._point_blocks,
                self._body.blocks,
            )
        # Between frames that are close, only what moves or occludes hinders the alignment; most
        # features may be on it.
        last_stamp_s, self._stamp_s = self._stamp_s, images.stamp_s
        is_after_large_step = images.stamp_s - last_stamp_s > MAX_PREDICTION_S
        if self._track is None:
            return self._start(frame, images, is_reset=False)
        track = self._track.with_pose_prior(frame.pose_prior)
        motion_state = track.motion_state
        # Prediction and alignment: from where the last motion leads, coarse to fine.
        with self._timer.stage("align"):
            result = self._align(images, track)
        # Recovery: if the frame does not fit, or the prediction is old.
        match = None
        if rejection_reason(result.alignment) or motion_state.is_stale(images.stamp_s):
            with self._timer.stage("recovery"):
                result, match = self._recovery.recover(
                    frame, images, result, motion_state, self._map
                )
            # Depth that does not fit a motion that features confirm is noisier than it seemed.
            if match is not None and match.agrees(result):
                noise = self._depth_noise.raised_for(result.alignment)
                if noise is not self._depth_noise:
                    self._depth_noise, self._stamp_s = noise, last_stamp_s
                    return self.estimate(frame)
        result = self._reinitialize_first_keyframe(images, result, track)
        # Quality: a motion that may be wrong is rejected.
        if reason := rejection_reason_after(
            result, motion_state, images, match
        ) or occlusion_reason(result.alignment):
            if match is not None and is_after_large_step:
                return self._follow_features(frame, images, track, match, reason)
            return self._fail(frame, images, track, result, reason)
        # Covariance: a view that constrains too little is accepted for a short time only; then
        # features tell the motion, as wheels do.
        with self._timer.stage("covariance"):
            uncertainty = self._estimate_uncertainty(images, result, track)
        reason = uncertainty.rejection_reason
        is_untold = bool(reason) and not motion_state.is_predictable(images.stamp_s)
        if is_untold:
            with self._timer.stage("recovery"):
                told = self._recovery.tell_motion(frame, motion_state, result.keyframe, self._map)
            if told is not None:
                self._stamp_s = last_stamp_s
                return self.estimate(told)
        self._brightness_weight = self._brightness_weight.update(uncertainty.shared_error)
        if is_untold:
            return self._fail(frame, images, track, result, reason)
        if contradiction := contradiction_reason(result, uncertainty, motion_state, images.stamp_s):
            return self._fail(frame, images, track, result, contradiction)
        # Filter: the measured pose is fused with the predicted one.
        result, uncertainty, normalized_innovation = fuse_with_prediction(
            result, uncertainty, motion_state, images.stamp_s
        )
        tracked = TrackedFrame(
            frame,
            images,
            result,
            motion_state,
            is_well_constrained=not reason,
            timing_errors=uncertainty.timing_errors,
        )
        # Keyframe: when the current one goes out of view, the next one is selected.
        if not needs_keyframe(tracked):
            return self._advance(track, tracked, uncertainty, normalized_innovation)
        with self._timer.stage("refine"):
            refined, now = refine(track.last_frame, tracked, self._map)
        estimate = self._advance(
            track, now, uncertainty, normalized_innovation, is_replaceable(refined, self._map)
        )
        self._deferred.add(partial(self._select_keyframe, tracked, now, refined))
        return estimate

    def _align(self, images: ImagePyramid, track: DirectTrack) -> TrackingResult:
        keyframe, motion_state = track.keyframe, track.motion_state
        prior = motion_state.motion_prior(keyframe.T_world_keyframe, images.stamp_s)
        alignment = align(
            keyframe.points,
            images,
            motion_state.predict_alignment(keyframe.T_world_keyframe, images.stamp_s),
            prior,
            motion_state.gain,
            uniform_weights(),
        )
        return TrackingResult(keyframe, alignment, prior)

    def _reinitialize_first_keyframe(
        self, images: ImagePyramid, result: TrackingResult, track: DirectTrack
    ) -> TrackingResult:
        """Rebuild the first keyframe of a rolling shutter, now that the velocity is known."""
        if not track.is_first or images.shutter.is_instant or rejection_reason(result.alignment):
            return result
        for _ in range(REINITIALIZATIONS):
            result = rebuild_first_keyframe(result, images, ALL_STATIC)
        self._map.reset(result.keyframe)
        return result

    def _estimate_uncertainty(
        self, images: ImagePyramid, result: TrackingResult, track: DirectTrack
    ) -> MotionUncertainty:
        velocity_noise = track.motion_state.update_velocity_noise(result.alignment.camera_velocity)
        return estimate_uncertainty(
            result.keyframe.points,
            images,
            result.alignment,
            result.prior,
            velocity_noise,
            result.keyframe.motion,
        )

    def _select_keyframe(
        self, tracked: TrackedFrame, now: TrackedFrame, refined: TrackedFrame
    ) -> None:
        """Select the keyframe of the next frames, and learn what a keyframe's distance shows.

        Args:
            tracked: The last good frame.
            now: The same with its refined pose.
            refined: The frame that may become a keyframe, see `refine`.
        """
        assert self._track is not None
        keyframe = tracked.result.keyframe
        with self._timer.stage("keyframe"):
            self._vignetting = self._vignetting.update(
                keyframe, tracked.images, tracked.result.alignment
            )
            self._depth_noise = self._depth_noise.update(tracked.images)
            if tracked.is_well_constrained:
                T_keyframe_camera = inverse(now.result.alignment.T_camera_keyframe)
                self._body = self._body.update(tracked.images, keyframe, T_keyframe_camera)
            selected = select(refined, self._map)
        if selected is not keyframe:
            motion_state = replace(self._track.motion_state, gain=1.0)
            self._track = replace(self._track, keyframe=selected, motion_state=motion_state)

    def _start(self, frame: RgbdFrame, images: ImagePyramid, is_reset: bool) -> Estimate:
        """Make this frame the first keyframe, if others can be aligned with it."""
        self._depth_noise = self._depth_noise.update(images)
        images = replace(images, depth_noise=self._depth_noise.value_per_m)
        keyframe = make_keyframe(frame, images, self._T_world_camera, zero_motion(), ALL_STATIC)
        debug = TrackingDebug(keypoints_px=project_keyframe_points(keyframe))
        if reason := self._start_rejection_reason(keyframe, images):
            return self._make_estimate(False, f"cannot start: {reason}", debug)
        self._map.reset(keyframe)
        motion_state = MotionState.at_rest(self._T_world_camera, images.stamp_s)
        self._track = DirectTrack(keyframe, motion_state, self._T_world_camera, is_first=True)
        self._failures = 0
        return replace(self._make_estimate(True, "", debug), is_reset=is_reset)

    def _start_rejection_reason(self, keyframe: DirectKeyframe, images: ImagePyramid) -> str:
        """Why a frame is no first keyframe: the next ones could not be aligned with it."""
        if len(keyframe.points[0].brightness) < MIN_KEYFRAME_POINTS:
            return f"only {len(keyframe.points[0].brightness)} points with depth"
        self_alignment = align(
            keyframe.points,
            images,
            np.eye(4),
            STATIC_PRIOR,
            1.0,
            uniform_weights(),
        )
        return (
            rejection_reason(self_alignment)
            or estimate_uncertainty(
                keyframe.points, images, self_alignment, STATIC_PRIOR, np.zeros(2)
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
        """Keep the pose; after too many failures drop the keyframes and start again.

        If wheels or features tell the motion, go on by it.
        """
        self._failures += 1
        if track.motion_state.told_motion is not None:
            return self._follow_told_motion(frame, images, track, result, reason)
        lost_s = images.stamp_s - track.motion_state.stamp_s
        if self._failures > MAX_FAILURES and (track.is_first or lost_s > MAX_LOST_S):
            return self._start(frame, images, is_reset=True)
        return self._make_estimate(
            False, reason, make_tracking_debug(result.keyframe, result.alignment)
        )

    def _follow_told_motion(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        track: DirectTrack,
        result: TrackingResult,
        reason: str,
    ) -> Estimate:
        """Take over the predicted pose; after too many failures the keyframe is this frame."""
        last, told = track.motion_state, track.motion_state.told_motion
        assert told is not None
        T_world_camera = last.predict_pose(images.stamp_s)
        covariance = invert_cholesky(information_of_prediction(last, images.stamp_s))
        velocity = last.predict_velocity(images.stamp_s)
        motion_state = last.advance(
            T_world_camera,
            velocity,
            images.stamp_s,
            last.gain,
            last.normalized_innovation,
            last.well_constrained_stamp_s,
        )
        keyframe, is_next_reference = track.keyframe, False
        if self._failures > MAX_FAILURES:
            motion = constant_velocity_motion(velocity)
            candidate = make_keyframe(frame, images, T_world_camera, motion, ALL_STATIC)
            if not self._start_rejection_reason(candidate, images):
                keyframe, is_next_reference, self._failures = candidate, True, 0
                self._map.add(keyframe)
        T_reference_camera = inverse(track.T_world_reference) @ T_world_camera
        T_world_reference = T_world_camera if is_next_reference else track.T_world_reference
        self._track = DirectTrack(keyframe, motion_state, T_world_reference)
        self._T_world_camera = T_world_camera
        return self._make_estimate(
            True,
            f"{told.source} only: {reason}",
            make_tracking_debug(result.keyframe, result.alignment),
            T_reference_camera,
            covariance,
            is_next_reference=is_next_reference,
        )

    def _follow_features(
        self,
        frame: RgbdFrame,
        images: ImagePyramid,
        track: DirectTrack,
        match: KeyframeMatch,
        reason: str,
    ) -> Estimate:
        """Take over the pose by features, and go on with this frame as the keyframe."""
        last, T_world_camera = track.motion_state, match.T_world_camera
        elapsed_s = images.stamp_s - last.stamp_s
        moved = se3_log(np.ascontiguousarray(inverse(last.T_world_camera) @ T_world_camera))
        velocity = moved / elapsed_s if last.is_recent(images.stamp_s) else np.zeros(6)
        motion = constant_velocity_motion(velocity)
        keyframe = make_keyframe(frame, images, T_world_camera, motion, ALL_STATIC)
        self._map.add(keyframe)
        motion_state = replace(
            MotionState.at_rest(T_world_camera, images.stamp_s), velocity=velocity
        )
        self._track = DirectTrack(keyframe, motion_state, T_world_camera)
        self._T_world_camera, self._failures = T_world_camera, 0
        return self._make_estimate(
            True,
            f"features only: {reason}",
            TrackingDebug(keypoints_px=project_keyframe_points(keyframe)),
            inverse(track.T_world_reference) @ T_world_camera,
            match.covariance,
        )

    def _advance(
        self,
        track: DirectTrack,
        tracked: TrackedFrame,
        uncertainty: MotionUncertainty,
        normalized_innovation: float,
        is_keyframe_replaced: bool = False,
    ) -> Estimate:
        """Take over the tracked frame, and return the estimate."""
        images, result = tracked.images, tracked.result
        is_next_reference = is_keyframe_replaced or result.keyframe is not track.keyframe
        motion_state = track.motion_state.advance(
            result.T_world_camera,
            result.alignment.camera_velocity,
            images.stamp_s,
            result.alignment.gain,
            normalized_innovation,
            images.stamp_s
            if tracked.is_well_constrained
            else track.motion_state.well_constrained_stamp_s,
        )
        T_reference_camera = inverse(track.T_world_reference) @ result.T_world_camera
        T_world_reference = result.T_world_camera if is_next_reference else track.T_world_reference
        self._T_world_camera = result.T_world_camera
        self._track = DirectTrack(
            result.keyframe,
            motion_state,
            T_world_reference,
            last_frame=tracked,
        )
        self._failures = 0
        return self._make_estimate(
            True,
            result.degradation or degradation_reason(result.alignment),
            make_tracking_debug(result.keyframe, result.alignment),
            T_reference_camera,
            uncertainty.covariance,
            is_next_reference=is_next_reference,
            # The drift of a told motion has been added up since the last good view.
            has_biased_error=uncertainty.has_biased_error
            and not (uncertainty.rejection_reason and track.motion_state.told_motion),
        )

    def _make_estimate(
        self,
        ok: bool,
        reason: str,
        debug: TrackingDebug,
        T_reference_camera: Array | None = None,
        covariance: Array | None = None,
        is_next_reference: bool = True,
        has_biased_error: bool = False,
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
            is_next_reference=is_next_reference,
            has_biased_error=has_biased_error,
            depth_noise_per_m=self._depth_noise.measured_per_m,
            debug=debug,
        )

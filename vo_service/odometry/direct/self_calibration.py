"""Direct odometry that learns the sensor's timing and focal length while it runs.

What a frame tells of its timing is a prior, see `TimingPrior`. If it is uncertain, the first moving
frames are tracked with several timings, and the odometry goes on with the best one. Each tracked
view adds to the estimate, two frames late, when the velocity at it is known.
"""

from dataclasses import replace
from functools import partial
from math import exp, hypot, log

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, inverse
from vo_service.odometry.direct.alignment import align, uniform_weights
from vo_service.odometry.direct.calibration import CalibrationFilter
from vo_service.odometry.direct.calibration_equations import (
    FOCAL,
    TIMING,
    CalibrationView,
    measure_calibration,
)
from vo_service.odometry.direct.calibration_search import (
    TimingSearch,
    TimingSearchResult,
    needs_search,
)
from vo_service.odometry.direct.image_pyramid import (
    ALL_STATIC,
    build_image_pyramid,
)
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.keyframe_correction import (
    SPARSE_STRIDE,
    correct_camera,
    correct_frame,
    correct_keyframe,
    correct_shutter,
    told_shutter,
)
from vo_service.odometry.direct.keyframe_selection import TrackedFrame
from vo_service.odometry.direct.motion import constant_velocity_motion, se3_log, zero_motion
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import (
    CALIBRATION_STRIDE,
    FOCAL_PRIOR_SIGMA,
    MAX_POSE_INTERVAL_S,
    MIN_CALIBRATION_SPEED,
    SCENE_DEPTH_M,
    TRIAL_INTERVAL,
)
from vo_service.odometry.direct.quality import TrackingResult
from vo_service.odometry.direct.view_history import TrackedView, ViewHistory
from vo_service.types.estimate import Estimate, OnlineFocalLength, OnlineTiming
from vo_service.types.odometry import ImmediateWork, NullStageTimer, StageTimer, WorkQueue


class SelfCalibratingOdometry:
    """Direct odometry with learned timing and focal length.

    Args:
        tracker: Tracks the frames.
        timer: Times the stages; not timed if None.
        deferred: Takes the learning, after the work of `tracker`; it is done at once if None.
    """

    def __init__(
        self,
        tracker: DirectOdometry,
        timer: StageTimer | None = None,
        deferred: WorkQueue | None = None,
    ) -> None:
        self._tracker = tracker
        self._timer = timer or NullStageTimer()
        self._deferred = deferred or ImmediateWork()
        self._history = ViewHistory()
        self._filter: CalibrationFilter | None = None
        self._sensor: tuple[str, PinholeCamera] | None = None
        self._is_search_needed = False
        self._search: TimingSearch | None = None
        self._view_count = self._untried_count = 0

    @property
    def calibration(self) -> CalibrationFilter | None:
        """What has been learned, as corrections of what frames tell; None before any frame."""
        return self._filter

    @property
    def tracker(self) -> DirectOdometry:
        """The odometry that tracks the frames."""
        return self._tracker

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose, see `DirectOdometry.estimate`, and learn from it."""
        if frame.timing_prior is None:
            return self._tracker.estimate(frame)
        before = self._tracker.last_frame or self._tracker.active_keyframe
        # Another sensor has been plugged in: it has its own calibration.
        if self._filter is None or self._sensor != (frame.serial, frame.camera):
            self._start(frame)
            before = None
        corrected = correct_frame(frame, self._learned.in_use)
        estimate = self._add_calibration_error(self._tracker.estimate(corrected))
        if estimate.is_reset:
            self._history.clear()
            self._search = before = None
        if not estimate.ok:
            self._history.interrupt()
            # The timing that a search has found may be wrong.
            self._is_search_needed |= needs_search(self._learned.sigmas[TIMING])
        if self._is_search_needed:
            self._deferred.run()
            self._learn(frame, estimate)
            with self._timer.stage("calibration"):
                estimate = self._search_timing(corrected, frame, estimate, before)
            return self._with_report(frame, estimate)
        reported = self._with_report(frame, estimate)
        self._deferred.add(partial(self._learn, frame, estimate))
        return reported

    def _with_report(self, frame: RgbdFrame, estimate: Estimate) -> Estimate:
        return replace(
            estimate,
            timing=self._report_timing(frame),
            focal_length=self._report_focal_length(frame),
        )

    def _add_calibration_error(self, estimate: Estimate) -> Estimate:
        """Add the error of the calibration in use to the covariance of an estimate.

        A wrong focal length changes the motion since the reference about in proportion; a wrong
        timing changes it by the `timing_errors` of its view.
        """
        if not estimate.ok:
            return estimate
        motion = se3_log(np.ascontiguousarray(estimate.T_reference_camera))
        # Features and wheels give a pose without an alignment.
        tracked = self._tracker.last_frame
        timing_errors = np.zeros((6, 2)) if tracked is None else tracked.timing_errors
        by_calibration = np.column_stack([timing_errors, motion]) * self._learned.errors
        return replace(estimate, covariance=estimate.covariance + by_calibration @ by_calibration.T)

    @property
    def _learned(self) -> CalibrationFilter:
        assert self._filter is not None
        return self._filter

    def _start(self, frame: RgbdFrame) -> None:
        """Start with what the first frame of a sensor tells."""
        self._sensor = frame.serial, frame.camera
        self._history.clear()
        self._search = None
        sigmas_s = _told_sigmas_s(frame)
        self._is_search_needed = needs_search(sigmas_s)
        self._filter = _make_filter(frame, np.zeros(2), sigmas_s)

    # -- search ----------------------------------------------------------------------------------
    def _search_timing(
        self,
        frame: RgbdFrame,
        told: RgbdFrame,
        estimate: Estimate,
        before: TrackedFrame | DirectKeyframe | None,
    ) -> Estimate:
        """Search for the timing once there is motion or tracking fails.

        Args:
            frame: The frame as it was tracked.
            told: The frame as it came from the camera.
            estimate: Its estimate.
            before: The good frame before it, or the first keyframe.

        Returns:
            The estimate, with the pose by the timing if that has been found.
        """
        if self._learned.is_certain:
            self._search, self._is_search_needed = None, False
            return estimate
        is_fast = _speed(self._tracker.velocity) > MIN_CALIBRATION_SPEED
        if self._search is None and before is not None and (is_fast or not estimate.ok):
            # Frames that are rare tell neither a velocity nor, from it, a timing.
            if frame.stamp_s - before.images.stamp_s > MAX_POSE_INTERVAL_S:
                return estimate
            keyframe = before if isinstance(before, DirectKeyframe) else _at_rest(before)
            self._search = TimingSearch(_told_sigmas_s(told), keyframe)
        if self._search is None:
            return estimate
        last = self._tracker.last_frame
        is_tracked = last is not None and last.images.stamp_s == frame.stamp_s
        images = last.images if last and is_tracked else build_image_pyramid(frame)
        self._search.add(images, is_degraded=estimate.ok and bool(estimate.reason))
        found = self._search.evaluate()
        if not found.is_last:
            return estimate
        if found.is_clear:
            self._continue_from(found, self._search, told, estimate.ok)
            if estimate.ok:
                estimate = _correct_pose(estimate, self._tracker.T_world_camera)
        self._is_search_needed = not (found.is_clear or (is_fast and not found.is_degraded))
        self._search = None
        return estimate

    def _continue_from(
        self,
        found: TimingSearchResult,
        search: TimingSearch,
        told: RgbdFrame,
        is_reference: bool,
    ) -> None:
        """Go on with a timing that the search has found: its frames are tracked again with it.

        Args:
            found: The timing.
            search: With the frames.
            told: The last frame as it came from the camera.
            is_reference: Whether that frame is the reference of the next motion.
        """
        first, best = search.keyframe, search.track_with(found.mean)
        self._filter = _make_filter(told, found.mean, found.sigmas_s)
        calibration, images = self._filter.in_use, first.images
        keyframe = make_keyframe(
            first.frame,
            replace(images, shutter=correct_shutter(images.shutter, calibration)),
            first.T_world_keyframe,
            constant_velocity_motion(best.velocity_of_first),
            ALL_STATIC,
        )
        motion_state = best.motion_state
        if not best.is_well_constrained:
            stamp_s = self._tracker.well_constrained_stamp_s
            motion_state = replace(motion_state, well_constrained_stamp_s=stamp_s)
        self._tracker.continue_from([keyframe], keyframe, motion_state, is_reference)
        self._history.clear()
        for stamp_s, T_world_camera in best.poses:
            view = TrackedView(stamp_s, images.shutter, calibration, T_world_camera)
            self._history.add(view, [keyframe])

    # -- learning --------------------------------------------------------------------------------
    def _learn(self, frame: RgbdFrame, estimate: Estimate) -> None:
        """Learn from a frame, if it was tracked."""
        if not estimate.ok:
            return
        with self._timer.stage("calibration"):
            before, tracked = self._learned.in_use, self._tracker.last_frame
            view = TrackedView(frame.stamp_s, told_shutter(frame), before, estimate.T_world_camera)
            # A degenerate view fits with a wrong calibration as well.
            if tracked and tracked.images.stamp_s == frame.stamp_s and tracked.is_well_constrained:
                view.tracked = tracked
            past = self._history.add(view, self._tracker.keyframes)
            if past is not None and past.tracked is not None:
                is_changed = self._add_view(past, past.tracked)
                past.tracked = None
                if is_changed:
                    self._correct_keyframes(before[FOCAL] == self._learned.in_use[FOCAL])
            if view.tracked is not None:
                self._compare(view, view.tracked)

    def _add_view(self, view: TrackedView, tracked: TrackedFrame) -> bool:
        """Learn from a view with known velocity; return whether the calibration has changed."""
        self._view_count += 1
        if self._view_count % CALIBRATION_STRIDE:
            return False
        keyframe, alignment = tracked.result.keyframe, tracked.result.alignment
        keyframe_view = self._history.find(keyframe.images.stamp_s)
        if (
            keyframe_view is None
            or not keyframe_view.has_velocity
            or _speed(view.velocity) < MIN_CALIBRATION_SPEED
        ):
            return False
        information = measure_calibration(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            CalibrationView(
                T_camera_keyframe=alignment.T_camera_keyframe,
                motion=alignment.motion,
                velocity=view.velocity,
                keyframe_motion=keyframe.motion,
                keyframe_velocity=keyframe_view.velocity,
                calibration=view.calibration,
                intrinsics=keyframe.images.intrinsics[0],
                height=keyframe.images.camera.height,
            ),
        )
        return self._learned.add(keyframe.images.stamp_s, information)

    def _compare(self, view: TrackedView, tracked: TrackedFrame) -> None:
        """Compare the fit of some frames with and without what was learned."""
        self._untried_count += 1
        if self._untried_count >= (TRIAL_INTERVAL if self._learned.is_tried else 1):
            self._untried_count = 0
            self._learned.compare(partial(self._misfit, view, tracked))

    def _misfit(self, view: TrackedView, tracked: TrackedFrame, calibration: Array) -> float:
        """Negative log-likelihood of a view by sparse points, with a calibration (3,)."""
        result = tracked.result
        keyframe = self._correct(result.keyframe, calibration, SPARSE_STRIDE)
        shutter = correct_shutter(view.told, calibration)
        alignment = align(
            keyframe.points,
            replace(tracked.images, camera=keyframe.images.camera, shutter=shutter),
            result.alignment.T_camera_keyframe,
            result.prior,
            result.alignment.gain,
            uniform_weights(),
        )
        return TrackingResult(keyframe, alignment, result.prior).negative_log_likelihood

    def _correct_keyframes(self, is_map_kept: bool) -> None:
        """Correct the active keyframe after a change, and the others or forget them."""
        old, active = self._tracker.active_keyframe, self._tracker.active_keyframe
        keyframes = []
        for keyframe in self._tracker.keyframes:
            if keyframe is old or is_map_kept:
                keyframes.append(self._correct(keyframe, self._learned.in_use))
                active = keyframes[-1] if keyframe is old else active
        assert active is not None
        self._tracker.continue_from(keyframes, active)

    def _correct(
        self, keyframe: DirectKeyframe, calibration: Array, stride: int = 1
    ) -> DirectKeyframe:
        """Return a keyframe with a calibration (3,), see `correct_keyframe`."""
        assert self._sensor is not None
        motion, shutter = keyframe.motion, keyframe.images.shutter
        view = self._history.find(keyframe.images.stamp_s)
        if view is not None:
            shutter = correct_shutter(view.told, calibration)
            motion = constant_velocity_motion(view.velocity) if view.has_velocity else motion
        camera = correct_camera(self._sensor[1], calibration)
        return correct_keyframe(keyframe, camera, shutter, motion, stride)

    # -- report ----------------------------------------------------------------------------------
    def _report_timing(self, frame: RgbdFrame) -> OnlineTiming:
        learned, prior = self._learned, frame.timing_prior
        assert prior is not None
        told = np.array([frame.readout_s, prior.depth_offset_s])
        readout_s, depth_offset_s = (told + learned.in_use[TIMING]).tolist()
        by_frames = learned.contradiction
        # An estimate that confirms what was told well is not called learned.
        is_learned = learned.is_certain and (
            learned.in_use[TIMING].any() or needs_search(_told_sigmas_s(frame))
        )
        return OnlineTiming(
            readout_s=readout_s,
            depth_offset_s=depth_offset_s,
            readout_sigma_s=float(learned.sigmas[0]),
            depth_offset_sigma_s=float(learned.sigmas[1]),
            source="learned" if is_learned else prior.source.value,
            contradiction=None if by_frames is None else tuple((told + by_frames).tolist()),
            is_refused=learned.timing_trial.is_refused,
        )

    def _report_focal_length(self, frame: RgbdFrame) -> OnlineFocalLength:
        learned = self._learned
        told = "intrinsics" if frame.focal_prior is None else "memory"
        return OnlineFocalLength(
            exp(learned.in_use[FOCAL]),
            float(learned.sigmas[FOCAL]),
            learned.disagreement,
            "learned" if learned.is_focal_learned else told,
            learned.focal_trial.is_refused,
        )


def _make_filter(frame: RgbdFrame, timing: Array, sigmas_s: Array) -> CalibrationFilter:
    """Make the filter that begins with a timing (2,), sigmas (2,), and the known focal length."""
    known = frame.focal_prior
    focal, sigma = (log(known.scale), known.sigma) if known else (0.0, FOCAL_PRIOR_SIGMA)
    return CalibrationFilter(
        np.append(timing, focal),
        np.append(sigmas_s, sigma),
        np.array([0.0, 0.0, focal]),
        -frame.readout_s,
    )


def _told_sigmas_s(frame: RgbdFrame) -> Array:
    prior = frame.timing_prior
    assert prior is not None
    # A value without error keeps its place by a tiny sigma.
    return np.maximum([prior.readout_sigma_s, prior.depth_offset_sigma_s], 1e-6)


def _correct_pose(estimate: Estimate, T_world_camera: Array) -> Estimate:
    """Replace the pose of an estimate; the correction is added to its covariance.

    The frame becomes the reference of the next motion, so that the covariance stays.
    """
    correction = se3_log(np.ascontiguousarray(inverse(estimate.T_world_camera) @ T_world_camera))
    return replace(
        estimate.with_pose(T_world_camera),
        covariance=estimate.covariance + np.outer(correction, correction),
        is_next_reference=True,
    )


def _speed(velocity: Array) -> float:
    """Speed in rad/s of a velocity (6,), as if everything were `SCENE_DEPTH_M` away."""
    translation, rotation = velocity[:3].tolist(), velocity[3:].tolist()
    return hypot(*rotation, hypot(*translation) / SCENE_DEPTH_M)


def _at_rest(tracked: TrackedFrame) -> DirectKeyframe:
    """Make a keyframe of a frame, as of a camera at rest."""
    T_world_camera = tracked.result.T_world_camera
    return make_keyframe(tracked.frame, tracked.images, T_world_camera, zero_motion(), ALL_STATIC)

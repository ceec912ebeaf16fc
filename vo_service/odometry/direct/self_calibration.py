"""Direct odometry that learns the sensor's timing and focal length while it runs.

What a frame tells of its timing is a prior, see `TimingPrior`. If it is uncertain, the first moving
frames are tracked with several timings, and the odometry goes on with the best one. Each tracked
view adds to the estimate, two frames late, when the velocity at it is known.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import exp, hypot, log

import numpy as np

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.direct.calibration import CalibrationFilter, CalibrationPrior
from vo_service.odometry.direct.calibration_equations import (
    FOCAL,
    TIMING,
    CalibrationView,
    measure_calibration,
)
from vo_service.odometry.direct.calibration_search import (
    SearchedFrame,
    TimingSearch,
    TimingSearchResult,
    needs_search,
)
from vo_service.odometry.direct.calibration_trial import TrialFrame
from vo_service.odometry.direct.image_pyramid import ALL_STATIC
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.keyframe_selection import TrackedFrame
from vo_service.odometry.direct.motion import constant_velocity_motion, se3_log
from vo_service.odometry.direct.motion_state import MotionState
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import (
    FOCAL_PRIOR_SIGMA,
    HALF_WEIGHT_SPEED,
    MAX_KEYFRAME_TIMING_ERRORS_S,
    MAX_POSE_INTERVAL_S,
    MIN_CALIBRATION_SPEED,
    SCENE_DEPTH_M,
    SETTLED_STRIDE,
    TRIAL_INTERVAL,
)
from vo_service.odometry.direct.view_history import (
    ToldFrame,
    TrackedView,
    ViewHistory,
    correct_camera,
    corrected_shutter,
)
from vo_service.types.estimate import Estimate, OnlineFocalLength, OnlineTiming
from vo_service.types.odometry import NullStageTimer, StageTimer


class SelfCalibratingOdometry:
    """Direct odometry with learned timing and focal length.

    Args:
        tracker: Tracks the frames.
        timer: Times the stages; not timed if None.
    """

    def __init__(self, tracker: DirectOdometry, timer: StageTimer | None = None) -> None:
        self._tracker = tracker
        self._timer = timer or NullStageTimer()
        self._history = ViewHistory()
        self._filter: CalibrationFilter | None = None
        self._sensor: tuple[str, PinholeCamera] | None = None
        self._is_search_needed = False
        # The last good frame with the pose at it, before the search.
        self._before_search: tuple[ToldFrame, Array] | None = None
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
        told = ToldFrame.of(frame)
        # Another sensor has been plugged in: it has its own calibration.
        if self._filter is None or self._sensor != (frame.serial, frame.camera):
            self._filter = self._start(told)
        if self._is_search_needed:
            with self._timer.stage("calibration"):
                self._end_search(told)
        estimate = self._track(told)
        if self._is_search_needed:
            with self._timer.stage("calibration"):
                self._search_timing(told, estimate)
        return replace(
            estimate,
            covariance=self._add_focal_error(estimate),
            timing=self._report_timing(frame),
            focal_length=self._report_focal_length(),
        )

    def _add_focal_error(self, estimate: Estimate) -> Array:
        """6x6 covariance of an estimate with the uncertainty of the focal length.

        A wrong focal length changes the motion since the reference about in proportion.
        """
        if not estimate.ok:
            return estimate.covariance
        motion = se3_log(np.ascontiguousarray(estimate.T_reference_camera))
        sigma = float(self._learned.sigmas[FOCAL])
        return estimate.covariance + sigma**2 * np.outer(motion, motion)

    @property
    def _learned(self) -> CalibrationFilter:
        assert self._filter is not None
        return self._filter

    # -- tracking --------------------------------------------------------------------------------
    def _start(self, told: ToldFrame) -> CalibrationFilter:
        """Start with what the first frame of a sensor tells."""
        frame = told.frame
        self._sensor = frame.serial, frame.camera
        self._history.clear()
        self._before_search = self._search = None
        sigmas_s = _told_sigmas_s(frame)
        self._is_search_needed = needs_search(sigmas_s)
        return _make_filter(told, np.zeros(2), sigmas_s)

    def _track(self, told: ToldFrame) -> Estimate:
        calibration = self._learned.in_use
        estimate = self._tracker.estimate(told.with_correction(calibration))
        if estimate.is_reset:
            self._history.clear()
        if not estimate.ok:
            self._history.interrupt()
            return estimate
        with self._timer.stage("calibration"):
            view = TrackedView(
                told.frame.stamp_s, told.timing, calibration, estimate.T_world_camera
            )
            tracked = self._tracker.last_frame
            # A degenerate view fits with a wrong calibration as well.
            is_aligned = tracked is not None and tracked.images.stamp_s == view.stamp_s
            if tracked is not None and is_aligned and tracked.is_well_constrained:
                view.keyframe, view.alignment = tracked.result.keyframe, tracked.result.alignment
            if self._learn(view, self._tracker.keyframes):
                self._correct_keyframes(calibration)
            if tracked is not None and view.keyframe is not None:
                self._compare(told, tracked, is_last=estimate.is_next_reference)
        return estimate

    # -- search ----------------------------------------------------------------------------------
    def _search_timing(self, told: ToldFrame, estimate: Estimate) -> None:
        """Begin the search once there is motion or tracking fails, and continue it.

        Frames that are rare tell neither a velocity nor, from it, a timing.
        """
        learned, before = self._learned, self._before_search
        if estimate.is_reset or learned.is_certain:
            self._search = None
            self._is_search_needed = not learned.is_certain
        is_moving = not estimate.ok or _speed(self._tracker.velocity) > HALF_WEIGHT_SPEED
        focal = float(learned.in_use[FOCAL])
        is_rare = (
            before is not None
            and told.frame.stamp_s - before[0].frame.stamp_s > MAX_POSE_INTERVAL_S
        )
        if self._search is None and before is not None and is_moving and not is_rare:
            first, T_world_first = before
            self._search = TimingSearch(
                SearchedFrame.of(first, focal), T_world_first, _told_sigmas_s(told.frame)
            )
        if self._search is not None:
            tracked = self._tracker.last_frame
            is_tracked = tracked is not None and tracked.images.stamp_s == told.frame.stamp_s
            images = tracked.images if tracked is not None and is_tracked else None
            self._search.add(SearchedFrame.of(told, focal, images))
        self._before_search = (told, estimate.T_world_camera) if estimate.ok else None

    def _end_search(self, told: ToldFrame) -> None:
        """Go on with the best timing, if the search has found it."""
        search = self._search
        if search is None or not search.num_compared:
            return
        found = search.evaluate()
        if not (found.is_certain or search.is_complete):
            return
        self._search = None
        if found.is_clear:
            self._is_search_needed = False
            self._continue_from(search, found)
        elif _speed(self._tracker.velocity) > HALF_WEIGHT_SPEED:
            self._is_search_needed = False

    def _continue_from(self, search: TimingSearch, found: TimingSearchResult) -> None:
        """Track the frames of the search again, with the timing found."""
        first = search.first
        self._filter = _make_filter(first.told, found.mean, found.sigmas_s)
        images = first.with_timing(self._filter.in_use)
        keyframe = make_keyframe(
            first.frame,
            images,
            search.T_world_first,
            constant_velocity_motion(found.best.velocity_of_first),
            ALL_STATIC,
        )
        # The estimates of these frames are not published, nor that they change the reference.
        T_world_reference = self._tracker.T_world_reference
        start = MotionState.at_rest(search.T_world_first, images)
        self._tracker.continue_from(keyframe, start)
        self._history.clear()
        self._history.add(
            TrackedView(
                images.stamp_s, first.told.timing, self._filter.in_use, search.T_world_first
            ),
            [keyframe],
        )
        for frame in search.frames:
            self._track(frame.told)
        self._tracker.continue_with_reference(T_world_reference)

    # -- learning --------------------------------------------------------------------------------
    def _learn(self, view: TrackedView, keyframes: Sequence[DirectKeyframe]) -> bool:
        """Add a view to the history, and learn from the one whose velocity is now known.

        Args:
            view: The view.
            keyframes: All that are in use.

        Returns:
            Whether the calibration in use has changed.
        """
        past = self._history.add(view, keyframes)
        if past is None or past.keyframe is None or past.alignment is None:
            return False
        assert past.velocity is not None
        self._view_count += 1
        speed = _speed(past.velocity)
        keyframe, alignment = past.keyframe, past.alignment
        keyframe_view = self._history.find(keyframe.images.stamp_s)
        if (
            speed < MIN_CALIBRATION_SPEED
            or keyframe_view is None
            or keyframe_view.velocity is None
            or (self._learned.is_settled and self._view_count % SETTLED_STRIDE)
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
                velocity=past.velocity,
                keyframe_motion=keyframe.motion,
                keyframe_velocity=keyframe_view.velocity,
                calibration=past.calibration,
                keyframe_timing=_timing_of(keyframe) - keyframe_view.told,
                intrinsics=keyframe.images.intrinsics[0],
                height=keyframe.images.camera.height,
            ),
        )
        weight = speed**4 / (speed**4 + HALF_WEIGHT_SPEED**4)
        return self._learned.add(keyframe.images.stamp_s, weight * information)

    def _compare(self, told: ToldFrame, tracked: TrackedFrame, is_last: bool) -> None:
        """Compare the fit of some frames with and without what was learned.

        Args:
            told: The frame.
            tracked: The frame, aligned with its keyframe.
            is_last: Whether the next frame has another keyframe.
        """
        self._untried_count += 1
        if self._learned.is_tried:
            is_due = self._untried_count >= SETTLED_STRIDE * TRIAL_INTERVAL
        else:
            is_due = is_last or self._untried_count >= TRIAL_INTERVAL
        view = self._history.find(tracked.result.keyframe.images.stamp_s)
        if is_due and view is not None and view.velocity is not None:
            self._untried_count = 0
            trial = TrialFrame(tracked, told.timing, told.frame.camera, view)
            self._learned.compare(trial.negative_log_likelihood)

    def _correct_keyframes(self, before: Array) -> None:
        """After a change: rebuild the active keyframe, forget those that are far off.

        Args:
            before: (3,) calibration in use before.
        """
        active = self._tracker.active_keyframe
        assert active is not None
        has_same_focal = before[FOCAL] == self._learned.in_use[FOCAL]
        rebuilt = self._rebuild(active)
        self._tracker.replace_keyframes(
            [
                rebuilt if keyframe is active else keyframe
                for keyframe in self._tracker.keyframes
                if keyframe is active or (has_same_focal and self._is_close(keyframe))
            ],
            rebuilt,
        )

    def _rebuild(self, keyframe: DirectKeyframe) -> DirectKeyframe:
        """Return a keyframe with the calibration in use; without velocity its timing stays."""
        assert self._sensor is not None
        calibration, shutter = self._learned.in_use, keyframe.images.shutter
        camera, motion = correct_camera(self._sensor[1], calibration), keyframe.motion
        view = self._history.find(keyframe.images.stamp_s)
        if view is not None and view.velocity is not None:
            shutter = corrected_shutter(view.told, calibration)
            motion = constant_velocity_motion(view.velocity)
        elif camera == keyframe.images.camera:
            return keyframe
        return make_keyframe(
            replace(keyframe.frame, camera=camera),
            replace(keyframe.images, camera=camera, shutter=shutter),
            keyframe.T_world_keyframe,
            motion,
            ALL_STATIC,
        )

    def _is_close(self, keyframe: DirectKeyframe) -> bool:
        """Whether a keyframe was made with nearly the timing in use."""
        view = self._history.find(keyframe.images.stamp_s)
        if view is None:
            return True
        off = np.abs(_timing_of(keyframe) - view.told - self._learned.in_use[TIMING])
        return bool((off <= MAX_KEYFRAME_TIMING_ERRORS_S).all())

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

    def _report_focal_length(self) -> OnlineFocalLength:
        learned = self._learned
        return OnlineFocalLength(
            exp(learned.in_use[FOCAL]),
            float(learned.sigmas[FOCAL]),
            learned.disagreement,
            learned.focal_source,
            learned.focal_trial.is_refused,
        )


def _make_filter(told: ToldFrame, timing: Array, sigmas_s: Array) -> CalibrationFilter:
    """Make the filter that begins with a timing (2,), sigmas (2,), and the known focal length."""
    known = told.frame.focal_prior
    focal, sigma = (log(known.scale), known.sigma) if known else (0.0, FOCAL_PRIOR_SIGMA)
    prior = CalibrationPrior(
        mean=np.append(timing, focal),
        sigmas=np.append(sigmas_s, sigma),
        unlearned=np.array([0.0, 0.0, focal]),
        focal_source="memory" if known else "intrinsics",
    )
    return CalibrationFilter(prior, -float(told.timing[0]))


def _told_sigmas_s(frame: RgbdFrame) -> Array:
    prior = frame.timing_prior
    assert prior is not None
    # A value without error keeps its place by a tiny sigma.
    return np.maximum([prior.readout_sigma_s, prior.depth_offset_sigma_s], 1e-6)


def _speed(velocity: Array) -> float:
    """Speed in rad/s of a velocity (6,), as if everything were `SCENE_DEPTH_M` away."""
    translation, rotation = velocity[:3].tolist(), velocity[3:].tolist()
    return hypot(*rotation, hypot(*translation) / SCENE_DEPTH_M)


def _timing_of(keyframe: DirectKeyframe) -> Array:
    """(2,) readout and delay that a keyframe was made with, s."""
    shutter = keyframe.images.shutter
    return np.array([shutter.readout_s, shutter.skew_s])

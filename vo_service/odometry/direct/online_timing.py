"""Direct odometry that learns readout and delay of the sensor while it runs.

The timing of a frame is a prior, see `TimingPrior`. If it is uncertain, the first moving frames are
tracked with several timings, and the odometry goes on with the best one. Each tracked view adds to
the estimate, two frames late, when the velocity at it is known.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import hypot

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from vo_service.odometry.direct import DirectOdometry
from vo_service.odometry.direct.gauss_newton import marginalize
from vo_service.odometry.direct.image_pyramid import ALL_STATIC, ImageTiming
from vo_service.odometry.direct.keyframe import DirectKeyframe, make_keyframe
from vo_service.odometry.direct.motion import constant_velocity_motion
from vo_service.odometry.direct.parameters import (
    FIRST_KEYFRAME_WEIGHT,
    HALF_WEIGHT_SPEED,
    MAX_KEYFRAME_TIMING_ERRORS_S,
    MIN_SEARCH_SPEED,
    MIN_TIMING_SPEED,
    SCENE_DEPTH_M,
    SETTLED_VIEW_STRIDE,
    TIMING_STEP_RATIO,
)
from vo_service.odometry.direct.timing_equations import (
    NUM_TIMING,
    TimedFrame,
    TimingView,
    TrackedView,
    ViewHistory,
    accumulate_timing,
    make_twists,
)
from vo_service.odometry.direct.timing_estimate import TimingEstimator
from vo_service.odometry.direct.timing_search import (
    SearchedFrame,
    TimingSearch,
    TimingSearchResult,
    needs_search,
)
from vo_service.types import Estimate, NullStageTimer, OnlineTiming, StageTimer


class OnlineTimingOdometry:
    """Direct odometry with learned timing.

    Args:
        tracker: Tracks the frames.
        timer: Times the stages; not timed if None.
    """

    def __init__(self, tracker: DirectOdometry, timer: StageTimer | None = None) -> None:
        self._tracker = tracker
        self._timer = timer or NullStageTimer()
        self._history = ViewHistory()
        self._estimator: TimingEstimator | None = None
        self._serial = ""
        self._is_search_needed = False
        # The last good frame with the pose at it, before the search.
        self._before_search: tuple[TimedFrame, Array] | None = None
        self._search: TimingSearch | None = None
        self._view_count = 0

    @property
    def vignetting(self) -> float:
        """Current estimate of the lens's vignetting, see `VignettingEstimate`."""
        return self._tracker.vignetting

    @property
    def timing_estimator(self) -> TimingEstimator | None:
        """Present estimator of the timing, as corrections of what frames tell; None = not yet."""
        return self._estimator

    @property
    def is_timing_certain(self) -> bool:
        """Whether the timing of the last frame is exact, or known well enough to be used."""
        return self._estimator is None or self._estimator.is_certain

    @property
    def tracker(self) -> DirectOdometry:
        """The odometry that tracks the frames."""
        return self._tracker

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the camera's pose, see `DirectOdometry.estimate`, and learn from it."""
        if frame.timing_prior is None:
            return self._tracker.estimate(frame)
        timed = TimedFrame.of(frame)
        # Another sensor has been plugged in: it has its own timing.
        if self._estimator is None or frame.serial != self._serial:
            self._start(timed)
        if self._is_search_needed:
            with self._timer.stage("timing"):
                self._end_search(timed)
        estimate = self._track(timed)
        if self._is_search_needed:
            with self._timer.stage("timing"):
                self._search_timing(timed, estimate)
        return replace(estimate, timing=self._report(frame))

    # -- tracking --------------------------------------------------------------------------------
    def _start(self, timed: TimedFrame) -> None:
        """Start with what the first frame of a sensor tells."""
        self._serial = timed.frame.serial
        self._history.clear()
        self._before_search = self._search = None
        sigmas_s = _prior_sigmas_s(timed.frame)
        self._use(np.zeros(2), sigmas_s, timed)
        self._is_search_needed = needs_search(sigmas_s)

    def _use(self, correction: Array, sigmas_s: Array, timed: TimedFrame) -> None:
        prior = timed.frame.timing_prior
        stamp_skew_s = timed.told[1] - (prior.depth_offset_s if prior else 0.0)
        instant = -timed.told if abs(stamp_skew_s) == 0.0 else np.array([-timed.told[0], -np.inf])
        self._estimator = TimingEstimator(correction, sigmas_s, correction, instant)

    def _track(self, timed: TimedFrame) -> Estimate:
        assert self._estimator is not None
        timing = self._estimator.in_use
        estimate = self._tracker.estimate(timed.with_correction(timing))
        if estimate.is_reset:
            self._history.clear()
        if not estimate.ok:
            self._history.interrupt()
            return estimate
        with self._timer.stage("timing"):
            if self._learn(self._make_view(timed, timing, estimate), self._tracker.keyframes):
                self._correct_keyframes()
        return estimate

    def _make_view(self, timed: TimedFrame, timing: Array, estimate: Estimate) -> TrackedView:
        tracked = self._tracker.last_frame
        stamp_s = timed.frame.stamp_s
        if tracked is None or tracked.images.stamp_s != stamp_s:
            return TrackedView.without_alignment(timed, estimate.T_world_camera, timing)
        result = tracked.result
        return TrackedView(
            stamp_s, estimate.T_world_camera, timed.told, timing, result.keyframe, result.alignment
        )

    # -- search ----------------------------------------------------------------------------------
    def _search_timing(self, timed: TimedFrame, estimate: Estimate) -> None:
        """Begin the search once there is motion or tracking fails, and continue it."""
        assert self._estimator is not None
        if estimate.is_reset or self._estimator.is_certain:
            self._search = None
            self._is_search_needed = not self._estimator.is_certain
        is_moving = not estimate.ok or _speed(self._tracker.velocity) > MIN_SEARCH_SPEED
        if self._search is None and self._before_search is not None and is_moving:
            first, T_world_first = self._before_search
            self._search = TimingSearch(
                SearchedFrame.of(first), T_world_first, _prior_sigmas_s(timed.frame)
            )
        if self._search is not None:
            tracked = self._tracker.last_frame
            self._search.add(
                SearchedFrame.of_tracked(timed, tracked.images)
                if tracked and tracked.images.stamp_s == timed.frame.stamp_s
                else SearchedFrame.of(timed)
            )
        self._before_search = (timed, estimate.T_world_camera) if estimate.ok else None

    def _end_search(self, timed: TimedFrame) -> None:
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
        elif _speed(self._tracker.velocity) > MIN_SEARCH_SPEED:
            self._is_search_needed = False

    def _continue_from(self, search: TimingSearch, found: TimingSearchResult) -> None:
        """Track the next frame from the best hypothesis on, with the timing found."""
        best, first = found.best, search.first.timed
        search.catch_up(best)
        self._history.clear()
        self._use(found.mean, found.sigmas_s, first)
        assert self._estimator is not None
        for view in best.views:
            self._learn(view, [best.keyframe])
        velocity = best.views[0].velocity
        readout_s, skew_s = (first.told + self._estimator.in_use).tolist()
        keyframe = make_keyframe(
            first.frame,
            replace(best.keyframe.images, shutter=ImageTiming(max(readout_s, 0.0), skew_s)),
            best.keyframe.T_world_keyframe,
            best.keyframe.motion if velocity is None else constant_velocity_motion(velocity),
            ALL_STATIC,
        )
        self._tracker.continue_from(keyframe, best.motion_state)

    # -- learning --------------------------------------------------------------------------------
    def _learn(self, view: TrackedView, keyframes: Sequence[DirectKeyframe]) -> bool:
        """Add a view to the history, and learn from the one whose velocity is now known.

        Args:
            view: The view.
            keyframes: All that are in use.

        Returns:
            Whether the timing in use has changed.
        """
        past = self._history.add(view, keyframes)
        if past is None or past.keyframe is None or past.alignment is None:
            return False
        assert self._estimator is not None
        assert past.velocity is not None
        self._view_count += 1
        is_settled = self._estimator.is_settled
        speed = _speed(past.velocity)
        keyframe_view = self._history.find(past.keyframe.images.stamp_s)
        if (
            speed < MIN_TIMING_SPEED
            or keyframe_view is None
            or keyframe_view.velocity is None
            or (is_settled and self._view_count % SETTLED_VIEW_STRIDE)
        ):
            return False
        keyframe, alignment = past.keyframe, past.alignment
        H, g = accumulate_timing(
            keyframe.points[0],
            alignment.samples,
            alignment.cell_weights,
            alignment.residual_model,
            _timing_view(past, keyframe_view),
        )
        information = marginalize(H, g, NUM_TIMING)
        weight = speed**4 / (speed**4 + HALF_WEIGHT_SPEED**4)
        if keyframe_view.is_first:
            weight *= FIRST_KEYFRAME_WEIGHT
        information[:, :NUM_TIMING] *= TIMING_STEP_RATIO * weight
        information[:, NUM_TIMING] *= weight
        return self._estimator.add(keyframe.images.stamp_s, speed, information)

    def _correct_keyframes(self) -> None:
        """After a change of the timing: rebuild the active keyframe, forget those far off."""
        assert self._estimator is not None
        timing = self._estimator.in_use
        active = self._tracker.active_keyframe
        assert active is not None
        rebuilt = self._rebuild(active, timing)
        self._tracker.replace_keyframes(
            [
                rebuilt if keyframe is active else keyframe
                for keyframe in self._tracker.keyframes
                if keyframe is active or self._is_close(keyframe)
            ],
            rebuilt,
        )

    def _rebuild(self, keyframe: DirectKeyframe, timing: Array) -> DirectKeyframe:
        """Return a keyframe with a corrected timing; the same if its velocity is not known yet."""
        view = self._history.find(keyframe.images.stamp_s)
        if view is None or view.velocity is None:
            return keyframe
        readout_s, skew_s = (view.told + timing).tolist()
        shutter = ImageTiming(max(readout_s, 0.0), skew_s)
        return make_keyframe(
            keyframe.frame,
            replace(keyframe.images, shutter=shutter),
            keyframe.T_world_keyframe,
            constant_velocity_motion(view.velocity),
            ALL_STATIC,
        )

    def _is_close(self, keyframe: DirectKeyframe) -> bool:
        """Whether a keyframe was made with nearly the timing in use."""
        view = self._history.find(keyframe.images.stamp_s)
        assert self._estimator is not None
        if view is None:
            return True
        off = np.abs(_keyframe_timing(keyframe, view) - self._estimator.in_use)
        return bool((off <= MAX_KEYFRAME_TIMING_ERRORS_S).all())

    # -- report ----------------------------------------------------------------------------------
    def _report(self, frame: RgbdFrame) -> OnlineTiming:
        estimator, prior = self._estimator, frame.timing_prior
        assert estimator is not None
        assert prior is not None
        told = np.array([frame.readout_s, prior.depth_offset_s])
        readout_s, depth_offset_s = (told + estimator.in_use).tolist()
        by_frames = estimator.contradiction
        # An estimate that confirms what was told well is not called learned.
        is_learned = estimator.is_certain and (
            estimator.in_use.any() or needs_search(_prior_sigmas_s(frame))
        )
        return OnlineTiming(
            readout_s=readout_s,
            depth_offset_s=depth_offset_s,
            readout_sigma_s=float(estimator.sigmas_s[0]),
            depth_offset_sigma_s=float(estimator.sigmas_s[1]),
            source="learned" if is_learned else prior.source.value,
            contradiction=None if by_frames is None else tuple((told + by_frames).tolist()),
        )


def _prior_sigmas_s(frame: RgbdFrame) -> Array:
    prior = frame.timing_prior
    assert prior is not None
    # A value without error keeps its place by a tiny sigma.
    return np.maximum([prior.readout_sigma_s, prior.depth_offset_sigma_s], 1e-6)


def _speed(velocity: Array) -> float:
    """Speed in rad/s of a velocity (6,), as if everything were `SCENE_DEPTH_M` away."""
    translation, rotation = velocity[:3].tolist(), velocity[3:].tolist()
    return hypot(*rotation, hypot(*translation) / SCENE_DEPTH_M)


def _keyframe_timing(keyframe: DirectKeyframe, view: TrackedView) -> Array:
    """(2,) correction that a keyframe was made with."""
    shutter = keyframe.images.shutter
    return np.array([shutter.readout_s, shutter.skew_s]) - view.told


def _timing_view(view: TrackedView, keyframe_view: TrackedView) -> TimingView:
    keyframe, alignment = view.keyframe, view.alignment
    assert keyframe is not None
    assert alignment is not None
    assert view.velocity is not None
    assert keyframe_view.velocity is not None
    twists, camera_position = make_twists(
        alignment.T_camera_keyframe,
        (alignment.motion, view.velocity),
        (keyframe.motion, keyframe_view.velocity),
    )
    return TimingView(
        twists=twists,
        camera_position=camera_position,
        timing=view.timing,
        keyframe_timing=_keyframe_timing(keyframe, keyframe_view),
        intrinsics=keyframe.images.intrinsics[0],
        height=keyframe.images.camera.height,
    )

"""The loop: frames in, poses out. `demo`, `replay` and `run` are all this loop."""

import re
import threading
import time
from collections.abc import Sequence
from dataclasses import replace

from drivers.camera import RgbdCamera, RgbdFrame
from vo_service.control.control import Control
from vo_service.feed import Feed
from vo_service.load.governor import FixedEffort, Governor
from vo_service.load.meter import FrameLoad
from vo_service.methods import BUDGETS_MS
from vo_service.pose_tracker import PoseTracker, StampedFrame
from vo_service.stage_clock import StageClock
from vo_service.stamps import StampClock, StampGuard
from vo_service.statistics import Statistics
from vo_service.types import (
    Estimate,
    Loops,
    NoLoops,
    Odometry,
    Output,
    PoseUpdate,
    Status,
    TrackingState,
    Troubled,
)

STATUS_PERIOD_S = 0.5


class Service:
    """Drives one camera's frames through one odometry and into the outputs.

    Everything here runs on the caller's thread; whatever could block has a thread or a process of
    its own. Frame or no frame, the loop comes round several times a second.
    """

    def __init__(
        self,
        feed: Feed,
        odometry: Odometry,
        stages: StageClock,
        tracker: PoseTracker,
        clock: StampClock,
        outputs: Sequence[Output],
        camera: RgbdCamera,
        method: str,
        control: Control,
        governor: Governor = FixedEffort(),  # noqa: B008 (it has no state)
        others: Sequence[Troubled] = (),
        loops: Loops = NoLoops(),  # noqa: B008 (it has no state)
    ) -> None:
        """`camera` and `method` are only told of in the status; frames come from `feed`.

        What the outputs, the governor and `others` complain of is in the status too.
        """
        self._feed = feed
        self._odometry = odometry
        self._stages = stages
        self._tracker = tracker
        self._clock = clock
        self._outputs = outputs
        self._camera = camera
        self._method = method
        self._control = control
        self._governor = governor
        self._loops = loops
        self._troubled: Sequence[Troubled] = (*outputs, governor, *others)
        self._guard = StampGuard()
        self._last: PoseUpdate | None = None
        self._told: tuple[str, ...] = ()
        self._told_at_s = 0.0
        self.statistics = Statistics()

    def run(self, stop: threading.Event) -> None:
        """Work until the frames end or `stop` is set."""
        self._report()
        for frame in self._feed.frames(stop):
            self._control.obey()
            if frame is not None and not self._control.is_paused:
                self._process(frame)
            self._report()

    def _process(self, frame: RgbdFrame) -> None:
        """One frame, from its stamp to the outputs."""
        begin_s, begin_cpu_s = time.monotonic(), time.thread_time()
        # Stamps only rise, or a new epoch says why not.
        verdict = self._guard.check(frame.stamp_s)
        if not verdict.use:
            self.statistics.stale += 1
            return
        if verdict.restarted or self._clock.has_stepped():
            self._tracker.begin_epoch("clock_step")
        # Where is the camera?
        estimate = self._odometry.estimate(frame)
        cpu_s = time.thread_time() - begin_cpu_s
        # What does that mean for the robot?
        update = self._update(frame, estimate)
        # Tell everyone.
        for output in self._outputs:
            output.pose(update)
        self.statistics.add(update, cpu_s * 1e3)
        self._last = update
        # Can the machine keep up?
        busy_s = time.monotonic() - begin_s
        interval_s, dropped = self.statistics.interval_s, self._feed.counters.dropped
        self._governor.frame(FrameLoad(busy_s, cpu_s, interval_s, dropped))

    def _update(self, frame: RgbdFrame, estimate: Estimate) -> PoseUpdate:
        stamped = StampedFrame(frame, self._clock.published_s(frame.stamp_s))
        latency_s = time.monotonic() - frame.arrival_s
        update = self._tracker.update(stamped, estimate, self._stages.take(), latency_s)
        return replace(update, map=self._loops.snapshot)

    def _report(self) -> None:
        """Publish the status, twice a second and whenever state, reason or warnings change."""
        state, reason = self._state()
        warnings = tuple(filter(None, (troubled.warning for troubled in self._troubled)))
        told = (state, *map(_without_numbers, (reason, *warnings)))
        now_s = time.monotonic()
        if told == self._told and now_s - self._told_at_s < STATUS_PERIOD_S:
            return
        self._told, self._told_at_s = told, now_s
        status = self._status(state, reason, warnings)
        for output in self._outputs:
            output.status(status)

    def _state(self) -> tuple[TrackingState, str]:
        if self._feed.reason:
            return TrackingState.NO_CAMERA, self._feed.reason
        if self._control.is_paused:
            return TrackingState.LOST, "paused"
        if self._last is None:
            return TrackingState.NO_CAMERA, "no frame yet"
        return self._last.state, self._last.reason or self._camera.condition.reason

    def _status(self, state: TrackingState, reason: str, warnings: tuple[str, ...]) -> Status:
        statistics, counters = self.statistics, self._feed.counters
        rolling = statistics.rolling()
        estimate = self._last.estimate if self._last else None
        the_map, places = self._control.map, self._loops.snapshot
        return Status(
            state=state,
            reason=reason,
            epoch=self._tracker.epoch,
            camera=self._camera.name,
            camera_state=self._camera.condition.state,
            intrinsics=self._camera.intrinsics_source,
            level=self._tracker.level,
            method=self._method,
            fps=rolling.fps,
            latency_p50_ms=rolling.latency_p50_ms,
            latency_p99_ms=rolling.latency_p99_ms,
            skew_ms=rolling.skew_ms,
            jitter_ms=rolling.jitter_ms,
            features=estimate.features if estimate else 0,
            matches=estimate.matches if estimate else 0,
            inliers=estimate.inliers if estimate else 0,
            frames=statistics.frames,
            failed=statistics.failed,
            dropped=counters.dropped,
            skipped=counters.skipped + statistics.stale,
            lost_packets=counters.lost_packets,
            paused=self._control.is_paused,
            recording=self._control.recording,
            map_keyframes=the_map.keyframes,
            saving_map=the_map.saving,
            saved_map=the_map.saved,
            loading_map=the_map.loading,
            loaded_map=the_map.loaded,
            places=places.places,
            loops=places.loops,
            is_located=self._last.is_located if self._last else places.is_located,
            warnings=warnings,
            cpu_ms_per_frame=rolling.cpu_ms_per_frame,
            stage_ms=rolling.stage_ms,
            stage_mean_ms=rolling.stage_mean_ms,
            stage_budget_ms=BUDGETS_MS.get(self._method, {}),
        )


def _without_numbers(text: str) -> str:
    """A reason with other counts than before is no other reason."""
    return re.sub(r"\d+", "", text)

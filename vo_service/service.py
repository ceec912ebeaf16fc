"""The real-time loop of `demo`, `replay` and `run`: frame, clock, odometry, odom frame, outputs."""

import re
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.camera import RgbdCamera, RgbdFrame
from vo_service.clock import PublishClock, TimestampFilter
from vo_service.control import Control
from vo_service.frame_source import FrameSource
from vo_service.load_shedding.load_meter import FrameCost
from vo_service.load_shedding.load_shedder import LoadShedder, NullLoadShedder
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.profiling import CpuStageTimer
from vo_service.odometry.registry import STAGE_BUDGETS_MS
from vo_service.service_statistics import ServiceStatistics
from vo_service.types import (
    Estimate,
    HasWarning,
    LoopClosure,
    NullLoopClosure,
    Odometry,
    OdometryUpdate,
    Output,
    Status,
    TrackingState,
)

STATUS_PERIOD_S = 0.5


@dataclass(frozen=True)
class ServiceInput:
    """Where frames come from.

    Attributes:
        camera: The camera, for the status.
        frame_source: Its frames; reconnects if the camera may come and go.
        clock: Converts stamps of frames to published stamps.
    """

    camera: RgbdCamera
    frame_source: FrameSource
    clock: PublishClock


@dataclass(frozen=True)
class Estimator:
    """The odometry with its name and its stage times.

    Attributes:
        method: Name of the method, for the status.
        odometry: Estimates the motion, with relocalization around it if there is any.
        stage_timer: Measures the stages of the odometry.
    """

    method: str
    odometry: Odometry
    stage_timer: CpuStageTimer


class Service:
    """The real-time loop: moves frames from a camera through an odometry to the outputs.

    The loop runs on the caller's thread. What could block has a thread or a process of its own. The
    loop turns several times a second, also without frames.
    """

    def __init__(
        self,
        service_input: ServiceInput,
        estimator: Estimator,
        odom_frame: OdomFrame,
        control: Control,
        outputs: Sequence[Output],
        load_shedder: LoadShedder = NullLoadShedder(),  # noqa: B008 (it has no state)
        warning_sources: Sequence[HasWarning] = (),
        loop_closure: LoopClosure = NullLoopClosure(),  # noqa: B008 (it has no state)
    ) -> None:
        """Connect the parts.

        Args:
            service_input: Camera, frames and clock.
            estimator: The odometry.
            odom_frame: Turns estimates into updates.
            control: Handles commands between two frames.
            outputs: Take updates and the status.
            load_shedder: Reduces the work if the machine is too slow.
            warning_sources: Whose warnings, beside those of the outputs, are in the status.
            loop_closure: Corrects the transform from map to odom.
        """
        self._camera = service_input.camera
        self._frame_source = service_input.frame_source
        self._clock = service_input.clock
        self._method = estimator.method
        self._odometry = estimator.odometry
        self._stage_timer = estimator.stage_timer
        self._odom_frame = odom_frame
        self._outputs = outputs
        self._control = control
        self._load_shedder = load_shedder
        self._loop_closure = loop_closure
        self._warning_sources: Sequence[HasWarning] = (*outputs, load_shedder, *warning_sources)
        self._timestamp_filter = TimestampFilter()
        self._last: OdometryUpdate | None = None
        self._last_reported: tuple[str, ...] = ()
        self._last_reported_s = 0.0
        self.statistics = ServiceStatistics()

    def run(self, stop: threading.Event) -> None:
        """Work until the frames end or `stop` is set."""
        self._publish_status()
        for frame in self._frame_source.frames(stop):
            self._control.process_pending()
            if frame is not None and not self._control.is_paused:
                self._process(frame)
            self._publish_status()

    def _process(self, frame: RgbdFrame) -> None:
        """One frame, from its stamp to the outputs."""
        begin_s, begin_cpu_s = time.monotonic(), time.thread_time()
        # Stamps only rise, or a new epoch says why not.
        verdict = self._timestamp_filter.check(frame.stamp_s)
        if not verdict.is_accepted:
            self.statistics.out_of_order += 1
            return
        if verdict.is_restart or self._clock.has_stepped():
            self._odom_frame.start_epoch("clock_step")
        # Where is the camera?
        estimate = self._odometry.estimate(frame)
        cpu_s = time.thread_time() - begin_cpu_s
        # What does that mean for the robot?
        update = self._make_update(frame, estimate)
        # Tell everyone.
        for output in self._outputs:
            output.on_update(update)
        self.statistics.add(update, cpu_s * 1e3)
        self._last = update
        # Can the machine keep up?
        busy_s = time.monotonic() - begin_s
        interval_s, dropped = self.statistics.interval_s, self._frame_source.counters.dropped
        self._load_shedder.add_frame(FrameCost(busy_s, cpu_s, interval_s, dropped))

    def _make_update(self, frame: RgbdFrame, estimate: Estimate) -> OdometryUpdate:
        stamped = StampedFrame(frame, self._clock.published_s(frame.stamp_s))
        latency_s = time.monotonic() - frame.receive_time_s
        update = self._odom_frame.update(
            stamped, estimate, self._stage_timer.take_stage_ms(), latency_s
        )
        return replace(update, map=self._loop_closure.snapshot)

    def _publish_status(self) -> None:
        """Publish the status, twice a second and whenever state, reason or warnings change."""
        state, reason = self._state()
        warnings = tuple(filter(None, (troubled.warning for troubled in self._warning_sources)))
        told = (state, *map(_strip_numbers, (reason, *warnings)))
        now_s = time.monotonic()
        if told == self._last_reported and now_s - self._last_reported_s < STATUS_PERIOD_S:
            return
        self._last_reported, self._last_reported_s = told, now_s
        status = self._make_status(state, reason, warnings)
        for output in self._outputs:
            output.on_status(status)

    def _state(self) -> tuple[TrackingState, str]:
        if self._frame_source.reason:
            return TrackingState.NO_CAMERA, self._frame_source.reason
        if self._control.is_paused:
            return TrackingState.LOST, "paused"
        if self._last is None:
            return TrackingState.NO_CAMERA, "no frame yet"
        return self._last.state, self._last.reason or self._camera.status.reason

    def _make_status(self, state: TrackingState, reason: str, warnings: tuple[str, ...]) -> Status:
        statistics, counters = self.statistics, self._frame_source.counters
        rolling = statistics.compute_rolling()
        estimate = self._last.estimate if self._last else None
        the_map, snapshot = self._control.map_state, self._loop_closure.snapshot
        return Status(
            state=state,
            reason=reason,
            epoch=self._odom_frame.epoch,
            camera=self._camera.name,
            camera_state=self._camera.status.state,
            intrinsics=self._camera.intrinsics_source,
            level=self._odom_frame.level_source,
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
            skipped=counters.skipped + statistics.out_of_order,
            lost_packets=counters.lost_packets,
            paused=self._control.is_paused,
            recording=self._control.recording,
            mesh_keyframes=the_map.keyframes,
            saving_map=the_map.saving,
            saved_map=the_map.saved,
            loading_map=the_map.loading,
            loaded_map=the_map.loaded,
            map_keyframes=snapshot.keyframes,
            loop_closures=snapshot.loop_closures,
            is_localized=self._last.is_localized if self._last else snapshot.is_localized,
            warnings=warnings,
            cpu_ms_per_frame=rolling.cpu_ms_per_frame,
            stage_ms=rolling.stage_ms,
            stage_mean_ms=rolling.stage_mean_ms,
            stage_budget_ms=STAGE_BUDGETS_MS.get(self._method, {}),
        )


def _strip_numbers(text: str) -> str:
    """A reason with other counts than before is no other reason."""
    return re.sub(r"\d+", "", text)

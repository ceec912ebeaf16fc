"""The real-time loop of `demo`, `replay` and `run`: frame, clock, odometry, odom frame, outputs.

With its statistics, which are the figures of the status.
"""

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from statistics import fmean, median, pstdev

import numpy as np

from drivers.camera import RgbdCamera, RgbdFrame
from drivers.plausibility import PlausibilityCheck
from vo_service.control import Control, LoadShedder
from vo_service.frame_source import FrameSource, PublishClock, TimestampFilter
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.stage_timers import STAGE_BUDGETS_MS, CpuStageTimer
from vo_service.types.estimate import Estimate, OnlineFocalLength, OnlineTiming
from vo_service.types.failure_reasons import FailureReasons, strip_numbers
from vo_service.types.messages import (
    CameraReport,
    LatencyReport,
    LevelReport,
    MapReport,
    RecorderReport,
    Status,
    TrackingReport,
)
from vo_service.types.odometry import Odometry
from vo_service.types.odometry_update import (
    AddScan,
    OdometryUpdate,
    TrackingState,
    add_no_scan,
)
from vo_service.types.outputs import HasWarning, LoopClosure, NullLoopClosure, Output

STATUS_PERIOD_S = 0.5


@dataclass(frozen=True)
class ServiceInput:
    """The input of the service: camera, frames and clock.

    Attributes:
        camera: The camera, for the status.
        frame_source: Its frames; reconnects if the camera may come and go.
        clock: Converts stamps of frames to published stamps.
    """

    camera: RgbdCamera
    frame_source: FrameSource
    clock: PublishClock


@dataclass(frozen=True)
class OdometryMethod:
    """The odometry method in use, with its stage times.

    Attributes:
        name: Its name, for the status.
        odometry: Estimates the motion, with relocalization around it if there is any.
        stage_timer: Measures the stages of the odometry.
    """

    name: str
    odometry: Odometry
    stage_timer: CpuStageTimer


class Service:
    """The real-time loop: moves frames from a camera through an odometry to the outputs.

    The loop runs on the caller's thread. Whatever could block has a thread or a process of its own.
    Commands and the status are handled several times a second, also without frames.
    """

    def __init__(
        self,
        service_input: ServiceInput,
        method: OdometryMethod,
        odom_frame: OdomFrame,
        control: Control,
        outputs: Sequence[Output],
        load_shedder: LoadShedder | None = None,
        warning_sources: Sequence[HasWarning] = (),
        loop_closure: LoopClosure = NullLoopClosure(),  # noqa: B008 (it has no state)
        add_scan: AddScan = add_no_scan,
    ) -> None:
        """Connect the parts.

        Args:
            outputs: Take updates and the status.
            load_shedder: Pauses the viewers if the machine is too slow; None for a replay.
            warning_sources: Whose warnings, beside those of the outputs, are in the status.
            loop_closure: Corrects the transform from map to odom.
            add_scan: Adds the scan to the updates.
        """
        self._camera = service_input.camera
        self._frame_source = service_input.frame_source
        self._clock = service_input.clock
        self._method_name = method.name
        self._odometry = method.odometry
        self._stage_timer = method.stage_timer
        self._odom_frame = odom_frame
        self._outputs = outputs
        self._control = control
        self._load_shedder = load_shedder or LoadShedder(())
        self._loop_closure = loop_closure
        self._add_scan = add_scan
        self._plausibility = PlausibilityCheck(self._camera)
        self._warning_sources: Sequence[HasWarning] = (
            *outputs,
            self._load_shedder,
            self._plausibility,
            odom_frame.leveling,
            *warning_sources,
        )
        self._timestamp_filter = TimestampFilter()
        self._last: OdometryUpdate | None = None
        self._last_reported: tuple[str, ...] = ()
        self._last_reported_s = 0.0
        self.statistics = ServiceStatistics()

    def run(self, stop: threading.Event) -> None:
        """Process frames until they end or `stop` is set."""
        self._publish_status()
        for frame in self._frame_source.frames(stop):
            self._control.process_pending()
            if frame is not None and not self._control.is_paused:
                self._process(frame)
            self._publish_status()

    def _process(self, frame: RgbdFrame) -> None:
        """Process one frame, from its stamp to the outputs."""
        begin_s, begin_cpu_s = time.monotonic(), time.thread_time()
        # Clock: stamps increase; a clock that was set starts a new epoch.
        stamp = self._timestamp_filter.check(frame.stamp_s)
        if not stamp.is_accepted:
            self.statistics.out_of_order += 1
            return
        if stamp.is_restart or self._clock.has_stepped():
            self._odom_frame.start_epoch("clock_step")
        # Prior: what wheels and a floor tell of the motion.
        frame = self._odom_frame.add_pose_prior(frame, self._clock.published_s(frame.stamp_s))
        # Odometry: the motion since the reference frame.
        estimate = self._odometry.estimate(frame)
        cpu_s = time.thread_time() - begin_cpu_s
        # Odom frame: the pose of the robot's base, its covariance and its state.
        update = self._make_update(frame, estimate)
        # Outputs: Zenoh, Rerun, recorder, mapper, trajectory file.
        for output in self._outputs:
            output.on_update(update)
        self.statistics.add(update, cpu_s * 1e3)
        self._last = update
        self._plausibility.add(frame)
        # Level: the floor in view keeps the next poses level.
        self._odom_frame.measure_level(update)
        # Load shedding: pause the viewers if the machine is too slow.
        if self._load_shedder.has_viewers:
            busy_s = time.monotonic() - begin_s
            interval_s, dropped = self.statistics.interval_s, self._camera.counters.dropped
            self._load_shedder.add_frame(busy_s, interval_s, dropped)

    def _make_update(self, frame: RgbdFrame, estimate: Estimate) -> OdometryUpdate:
        stamped = StampedFrame(frame, self._clock.published_s(frame.stamp_s))
        latency_s = time.monotonic() - frame.receive_time_s
        update = self._odom_frame.update(
            stamped, estimate, self._stage_timer.take_stage_ms(), latency_s
        )
        update = replace(update, map=self._loop_closure.snapshot, grid=self._control.grid)
        return self._add_scan(update)

    def _publish_status(self) -> None:
        """Publish the status, twice a second and whenever state, reason or warnings change."""
        state, reason = self._state()
        sources = (*self._warning_sources, self.statistics)
        warnings = tuple(filter(None, (source.warning for source in sources)))
        report = (state, *map(strip_numbers, (reason, *warnings)))
        now_s = time.monotonic()
        if report == self._last_reported and now_s - self._last_reported_s < STATUS_PERIOD_S:
            return
        self._last_reported, self._last_reported_s = report, now_s
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
        return Status(
            state=state,
            reason=reason,
            epoch=self._odom_frame.epoch,
            paused=self._control.is_paused,
            warnings=warnings,
            camera=self._camera_report(),
            level=self._level_report(),
            tracking=self._tracking_report(),
            latency=self.statistics.make_latency_report(
                STAGE_BUDGETS_MS.get(self._method_name, {})
            ),
            map=self._map_report(),
            recorder=RecorderReport(self._control.recording),
        )

    def _camera_report(self) -> CameraReport:
        counters = self._camera.counters
        report = CameraReport(
            name=self._camera.name,
            state=self._camera.status.state,
            intrinsics=self._camera.intrinsics_source,
            skew_ms=self.statistics.skew_ms,
            jitter_ms=self.statistics.jitter_ms,
            dropped=counters.dropped,
            skipped=counters.skipped + self.statistics.out_of_order,
            lost_packets=counters.lost_packets,
            depth_noise_per_m=self.statistics.depth_noise_per_m or 0.0,
        )
        if focal_length := self.statistics.focal_length:
            report = replace(
                report,
                focal_scale=focal_length.scale,
                focal_scale_sigma=focal_length.sigma,
                focal_source=focal_length.source,
                focal_disagreement=focal_length.disagreement or 0.0,
                focal_refused=focal_length.is_refused,
            )
        timing = self.statistics.timing
        if timing is None:
            return report
        return replace(
            report,
            sensor_timing_refused=timing.is_refused,
            readout_ms=1e3 * timing.readout_s,
            readout_sigma_ms=1e3 * timing.readout_sigma_s,
            depth_offset_ms=1e3 * timing.depth_offset_s,
            depth_offset_sigma_ms=1e3 * timing.depth_offset_sigma_s,
            sensor_timing_source=timing.source,
        )

    def _level_report(self) -> LevelReport:
        level = self._odom_frame.leveling.level
        return LevelReport(
            level.source,
            math.degrees(level.tilt_rad),
            math.degrees(level.sigma_rad),
            level.camera_height_m or 0.0,
        )

    def _tracking_report(self) -> TrackingReport:
        report = TrackingReport(
            self._method_name, frames=self.statistics.frames, failed=self.statistics.failed
        )
        if self._last is None:
            return report
        estimate = self._last.estimate
        return replace(
            report,
            features=estimate.features,
            matches=estimate.matches,
            inliers=estimate.inliers,
        )

    def _map_report(self) -> MapReport:
        mapper, snapshot = self._control.map_state, self._loop_closure.snapshot
        return MapReport(
            keyframes=snapshot.keyframes,
            loop_closures=snapshot.loop_closures,
            is_localized=self._last.is_localized if self._last else snapshot.is_localized,
            mesh_keyframes=mapper.mesh_keyframes,
            saving=mapper.saving,
            saved=mapper.saved,
            loading=mapper.loading,
            loaded=mapper.loaded,
        )


# Number of frames that the status describes.
WINDOW_FRAMES = 100
# The rate counts the frames of this time.
RATE_WINDOW_S = 2.0
# A longer time from one stamp to the next is a gap, not jitter.
MAX_INTERVAL_S = 1.0
# CPU times are kept for this many frames: a service runs for weeks.
MAX_RECORDED_FRAMES = 5_000


@dataclass
class ServiceStatistics:
    """Counts and times since the start.

    Attributes:
        now_s: The clock, s.
        frames: Number of processed frames.
        failed: Number of those without a motion estimate.
        out_of_order: Number of frames skipped because their stamp did not increase.
        start_s: Time of the first result; None before it.
        end_s: Time of the last result.
        failure_reasons: Why frames have no motion estimate.
        timing: The sensor's timing at the last frame; None if it is taken as exact.
    """

    now_s: Callable[[], float] = time.monotonic
    frames: int = 0
    failed: int = 0
    out_of_order: int = 0
    failure_reasons: FailureReasons = field(default_factory=FailureReasons)
    start_s: float | None = None
    end_s: float = 0.0
    _latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    _skew_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    _interval_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    timing: OnlineTiming | None = None
    focal_length: OnlineFocalLength | None = None
    depth_noise_per_m: float | None = None
    _last_frame: RgbdFrame | None = None
    _result_times_s: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    _cpu_ms: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_RECORDED_FRAMES))
    _stages_ms: dict[str, deque[float]] = field(default_factory=dict)
    _recent_stages_ms: deque[Mapping[str, float]] = field(
        default_factory=lambda: deque(maxlen=WINDOW_FRAMES)
    )

    def add(self, update: OdometryUpdate, cpu_ms: float) -> None:
        """Add one frame.

        Args:
            cpu_ms: CPU time of the odometry for it, ms.
        """
        self.frames += 1
        self.failed += not update.estimate.ok
        self.failure_reasons.add(update.estimate.ok, update.estimate.reason)
        self.timing = update.estimate.timing
        self.focal_length = update.estimate.focal_length
        self.depth_noise_per_m = update.estimate.depth_noise_per_m
        self.end_s = self.now_s()
        self.start_s = self.end_s if self.start_s is None else self.start_s
        self._cpu_ms.append(cpu_ms)
        self._latency_ms.append(update.latency_s * 1e3)
        self._result_times_s.append(self.end_s)
        self._add_stamp(update.frame)
        self._recent_stages_ms.append(update.stage_ms)
        for stage, spent_ms in update.stage_ms.items():
            record = self._stages_ms.setdefault(stage, deque(maxlen=MAX_RECORDED_FRAMES))
            record.append(spent_ms)

    @property
    def warning(self) -> str:
        """Warning if the frames contradict the timing that was told; "" otherwise."""
        return self.timing.warning if self.timing else ""

    def _add_stamp(self, frame: RgbdFrame) -> None:
        """Add an interval per frame of the camera: frames that were not delivered are no jitter."""
        last, self._last_frame = self._last_frame, frame
        self._skew_ms.append(frame.skew_s * 1e3)
        if last is None or frame.seq <= last.seq:
            return
        if frame.stamp_s - last.stamp_s <= MAX_INTERVAL_S:
            self._interval_ms.append((frame.stamp_s - last.stamp_s) * 1e3 / (frame.seq - last.seq))

    @property
    def interval_s(self) -> float:
        """Median frame interval of the camera in the last seconds, s; 0 = unknown."""
        return median(self._interval_ms) * 1e-3 if self._interval_ms else 0.0

    @property
    def skew_ms(self) -> float:
        """Median skew of the last frames, ms; 0 before the first frame."""
        return median(self._skew_ms) if self._skew_ms else 0.0

    @property
    def jitter_ms(self) -> float:
        """Standard deviation of the last frame intervals, ms; 0 before the second frame."""
        return pstdev(self._interval_ms) if self._interval_ms else 0.0

    def make_latency_report(self, stage_budget_ms: Mapping[str, float]) -> LatencyReport:
        """Make the report of the last seconds. All times are 0 before the first frame.

        Args:
            stage_budget_ms: Budget by stage, ms, copied into the report.
        """
        p50, p99 = np.percentile(list(self._latency_ms) or [0.0], (50, 99))
        return LatencyReport(
            fps=self._recent_fps(),
            p50_ms=float(p50),
            p99_ms=float(p99),
            cpu_ms_per_frame=_recent_median(self._cpu_ms),
            stage_ms={stage: _recent_median(spent) for stage, spent in self._stages_ms.items()},
            stage_mean_ms={
                stage: fmean(spent_ms.get(stage, 0.0) for spent_ms in self._recent_stages_ms)
                for stage in self._stages_ms
            },
            stage_budget_ms=stage_budget_ms,
        )

    def _recent_fps(self) -> float:
        now_s = self.now_s()
        recent_s = [at_s for at_s in self._result_times_s if now_s - at_s <= RATE_WINDOW_S]
        if len(recent_s) < 2 or recent_s[0] >= now_s:
            return 0.0
        return (len(recent_s) - 1) / (now_s - recent_s[0])

    @property
    def mean_fps(self) -> float:
        """Frames per second from the first result to the last."""
        if self.start_s is None or self.end_s <= self.start_s:
            return 0.0
        return (self.frames - 1) / (self.end_s - self.start_s)

    @property
    def cpu_ms_per_frame(self) -> float:
        """Median CPU time of the odometry, ms; decoding and outputs are not in it."""
        return median(self._cpu_ms) if self._cpu_ms else 0.0

    @property
    def stage_ms(self) -> Mapping[str, float]:
        """Median CPU time by stage, ms."""
        return {stage: median(spent) for stage, spent in self._stages_ms.items()}


def _recent_median(times_ms: deque[float]) -> float:
    """Median of the last `WINDOW_FRAMES`; the newest are at the right end."""
    newest = list(islice(reversed(times_ms), WINDOW_FRAMES))
    return median(newest) if newest else 0.0

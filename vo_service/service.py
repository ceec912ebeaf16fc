"""The real-time loop of `demo`, `replay` and `run`: frame, clock, odometry, odom frame, outputs."""

import re
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

from drivers.camera import RgbdCamera, RgbdFrame
from vo_service.control import Control
from vo_service.frame_source import FrameSource, PublishClock, TimestampFilter
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry import CpuStageTimer
from vo_service.odometry.registry import STAGE_BUDGETS_MS
from vo_service.service_statistics import LoadShedder, ServiceStatistics
from vo_service.types import Estimate, Odometry, OdometryUpdate, TrackingState
from vo_service.types.messages import (
    CameraReport,
    MapReport,
    RecorderReport,
    Status,
    TrackingReport,
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

    The loop runs on the caller's thread. Whatever could block has a thread or a process of its own.
    Commands and the status are handled several times a second, also without frames.
    """

    def __init__(
        self,
        service_input: ServiceInput,
        estimator: Estimator,
        odom_frame: OdomFrame,
        control: Control,
        outputs: Sequence[Output],
        load_shedder: LoadShedder | None = None,
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
            load_shedder: Pauses the viewers if the machine is too slow; None for a replay.
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
        self._load_shedder = load_shedder or LoadShedder(())
        self._loop_closure = loop_closure
        self._warning_sources: Sequence[HasWarning] = (
            *outputs,
            self._load_shedder,
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
        # Load shedding: pause the viewers if the machine is too slow.
        busy_s = time.monotonic() - begin_s
        interval_s, dropped = self.statistics.interval_s, self._camera.counters.dropped
        self._load_shedder.add_frame(busy_s, interval_s, dropped)

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
        sources = (*self._warning_sources, self.statistics)
        warnings = tuple(filter(None, (source.warning for source in sources)))
        report = (state, *map(_strip_numbers, (reason, *warnings)))
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
            tracking=self._tracking_report(),
            timing=self.statistics.make_timing_report(STAGE_BUDGETS_MS.get(self._method, {})),
            map=self._map_report(),
            recorder=RecorderReport(self._control.recording),
        )

    def _camera_report(self) -> CameraReport:
        counters = self._camera.counters
        report = CameraReport(
            name=self._camera.name,
            state=self._camera.status.state,
            intrinsics=self._camera.intrinsics_source,
            level=self._odom_frame.level_source,
            skew_ms=self.statistics.skew_ms,
            jitter_ms=self.statistics.jitter_ms,
            dropped=counters.dropped,
            skipped=counters.skipped + self.statistics.out_of_order,
            lost_packets=counters.lost_packets,
        )
        if focal_length := self.statistics.focal_length:
            report = replace(
                report,
                focal_scale=focal_length.scale,
                focal_scale_sigma=focal_length.sigma,
                focal_source=focal_length.source,
                focal_disagreement=focal_length.disagreement or 0.0,
            )
        timing = self.statistics.timing
        if timing is None:
            return report
        return replace(
            report,
            readout_ms=1e3 * timing.readout_s,
            readout_sigma_ms=1e3 * timing.readout_sigma_s,
            depth_offset_ms=1e3 * timing.depth_offset_s,
            depth_offset_sigma_ms=1e3 * timing.depth_offset_sigma_s,
            timing=timing.source,
        )

    def _tracking_report(self) -> TrackingReport:
        report = TrackingReport(
            self._method, frames=self.statistics.frames, failed=self.statistics.failed
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


def _strip_numbers(text: str) -> str:
    """Remove counts from a reason: a reason with other counts is not a new reason."""
    return re.sub(r"\d+", "", text)

"""The real-time loop of `demo`, `replay` and `run`: frame, clock, odometry, odom frame, outputs."""

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from drivers.camera import RgbdCamera, RgbdFrame
from drivers.plausibility import PlausibilityCheck
from vo_service.control import Control, LoadShedder
from vo_service.frame_source import FrameSource, PublishClock, TimestampFilter
from vo_service.odom_frame import OdomFrame, StampedFrame
from vo_service.odometry.stage_timers import CpuStageTimer
from vo_service.service_statistics import ServiceStatistics
from vo_service.service_status import StatusReporter
from vo_service.types.estimate import Estimate
from vo_service.types.failure_reasons import strip_numbers
from vo_service.types.odometry import DeferredWork, Odometry
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
        deferred: Keeps the odometry's work that can wait until an estimate is published.
    """

    name: str
    odometry: Odometry
    stage_timer: CpuStageTimer
    deferred: DeferredWork


@dataclass(frozen=True)
class ServiceOutputs:
    """What takes the updates and the status.

    Attributes:
        outputs: Take both.
        load_shedder: Pauses the viewers if the machine is too slow; without viewers in a replay.
        warning_sources: Whose warnings, beside those of the outputs, are in the status.
    """

    outputs: Sequence[Output]
    load_shedder: LoadShedder = field(default_factory=lambda: LoadShedder(()))
    warning_sources: Sequence[HasWarning] = ()


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
        outputs: ServiceOutputs,
        loop_closure: LoopClosure = NullLoopClosure(),  # noqa: B008 (it has no state)
        add_scan: AddScan = add_no_scan,
    ) -> None:
        """Connect the parts.

        Args:
            outputs: Take updates and the status.
            loop_closure: Corrects the transform from map to odom.
            add_scan: Adds the scan to the updates.
        """
        self._camera = service_input.camera
        self._frame_source = service_input.frame_source
        self._clock = service_input.clock
        self._odometry = method.odometry
        self._stage_timer = method.stage_timer
        self._deferred = method.deferred
        self._odom_frame = odom_frame
        self._outputs = outputs.outputs
        self._control = control
        self._load_shedder = outputs.load_shedder
        self._loop_closure = loop_closure
        self._add_scan = add_scan
        self._plausibility = PlausibilityCheck(self._camera)
        self._warning_sources: Sequence[HasWarning] = (
            *outputs.outputs,
            self._load_shedder,
            self._plausibility,
            odom_frame.leveling,
            *outputs.warning_sources,
        )
        self._timestamp_filter = TimestampFilter()
        self._last: OdometryUpdate | None = None
        self._last_reported: tuple[str, ...] = ()
        self._last_reported_s = 0.0
        self.statistics = ServiceStatistics()
        self._status = StatusReporter(
            self._camera, method.name, odom_frame, control, loop_closure, self.statistics
        )

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
        # Deferred: the odometry gets ready for the next frame.
        begin_cpu_s = time.thread_time()
        self._deferred.run()
        cpu_s += time.thread_time() - begin_cpu_s
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
        status = self._status.make_status(state, reason, warnings, self._last)
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

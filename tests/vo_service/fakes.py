"""Stand-ins for the parts around the loop: they answer by script and keep what they received."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.camera import (
    CameraCounters,
    CameraState,
    CameraStatus,
    Clock,
    EndOfStream,
    FrameTimeout,
    PinholeCamera,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core.geometry import Array
from vo_service.types.estimate import Estimate
from vo_service.types.messages import (
    CameraReport,
    LatencyReport,
    LevelReport,
    MapReport,
    RecorderReport,
    Status,
    TrackingReport,
)
from vo_service.types.odometry_update import OdometryUpdate, TrackingState

CAMERA = PinholeCamera(8, 6, 8.0, 8.0, 3.5, 2.5)
STEP_COVARIANCE = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])


def make_frame(seq: int, stamp_s: float | None = None) -> RgbdFrame:
    """An empty picture; 30 a second unless a stamp is given."""
    return RgbdFrame(
        seq=seq,
        stamp_s=100.0 + seq / 30 if stamp_s is None else stamp_s,
        receive_time_s=0.0,
        color_bgr=np.zeros((6, 8, 3), np.uint8),
        depth_raw=np.zeros((6, 8), np.uint16),
        depth_factor=1000.0,
        camera=CAMERA,
    )


def good_estimate(T_world_camera: Array, T_reference_camera: Array | None = None) -> Estimate:
    """An estimate that found its motion."""
    step = np.eye(4) if T_reference_camera is None else T_reference_camera
    return Estimate(True, "", T_world_camera, step, STEP_COVARIANCE, 500, 200, 150)


def failed_estimate(
    T_world_camera: Array | None = None, reason: str = "3 of 9 matches agree"
) -> Estimate:
    """An estimate that holds the last good pose."""
    T = np.eye(4) if T_world_camera is None else T_world_camera
    return Estimate(False, reason, T, np.eye(4), np.zeros((6, 6)), 20, 9, 3)


def make_status(**changes: Any) -> Status:
    """A service that tracks, but for what is named."""
    status = Status(
        state=TrackingState.TRACKING,
        reason="",
        epoch=1,
        paused=False,
        warnings=(),
        camera=CameraReport(
            name="scripted",
            state=CameraState.STREAMING,
            intrinsics="",
            skew_ms=-2.5,
            jitter_ms=0.5,
        ),
        level=LevelReport(),
        tracking=TrackingReport("surf", features=980, matches=400, inliers=300, frames=100),
        latency=LatencyReport(fps=29.9, p50_ms=11.0, p99_ms=19.5),
        map=MapReport(),
        recorder=RecorderReport(),
    )
    return replace(status, **changes)


class FakeClock:
    """Seconds that pass only when told."""

    def __init__(self, now_s: float = 1000.0) -> None:
        self.now_s = now_s

    def __call__(self) -> float:
        """The time now, as `time.monotonic`."""
        return self.now_s

    def thread_time(self) -> float:
        """As `time.thread_time`."""
        return 0.0

    @property
    def monotonic(self) -> Callable[[], float]:
        """So that the clock can stand in for the module `time`."""
        return self


@dataclass(frozen=True)
class Delay:
    """Something that takes a while: the clock moves on before it happens."""

    seconds: float
    event: RgbdFrame | Exception | CameraStatus


Event = RgbdFrame | Exception | CameraStatus | Delay


class ScriptedCamera(RgbdCamera):
    """Each `open` begins the next part of the script; a part that is an exception is its answer.

    Each `read` gives the next frame of the part or raises what stands there; a condition is how the
    camera is from then on, without a frame. A part that is over is the end of the stream.
    """

    name = "scripted"
    clock = Clock.RECORDED

    def __init__(self, *parts: Sequence[Event] | Exception, clock: FakeClock | None = None) -> None:
        self.opened = self.closed = 0
        self._parts = list(parts)
        self._events: list[Event] = []
        self._clock = clock or FakeClock()
        self._counters = CameraCounters()
        self._status = CameraStatus(CameraState.STREAMING)

    def open(self) -> None:
        """Begin the next part."""
        self.opened += 1
        part = self._parts.pop(0) if self._parts else []
        if isinstance(part, Exception):
            raise part
        self._events = list(part)

    def read(self, timeout_s: float) -> RgbdFrame:
        """The next event of this part."""
        event = self._events.pop(0) if self._events else EndOfStream()
        if isinstance(event, Delay):
            self._clock.now_s += event.seconds
            event = event.event
        if isinstance(event, Exception):
            raise event
        if isinstance(event, CameraStatus):
            self._status = event
            raise FrameTimeout
        self._status = CameraStatus(CameraState.STREAMING)
        self._counters = replace(self._counters, delivered=self._counters.delivered + 1)
        return event

    def wait_for_reconnect(self, timeout_s: float) -> None:
        """Let the clock go on."""
        self._clock.now_s += timeout_s

    def close(self) -> None:
        """Remember that it was called."""
        self.closed += 1

    @property
    def counters(self) -> CameraCounters:
        """Only `delivered` counts."""
        return self._counters

    @property
    def status(self) -> CameraStatus:
        """As the script says."""
        return self._status


class InstantStop(threading.Event):
    """A stop that nobody waits for: set after so many waits, it remembers how long each was."""

    def __init__(self, waits: int) -> None:
        super().__init__()
        self.waited_s: list[float | None] = []
        self._waits = waits

    def wait(self, timeout: float | None = None) -> bool:
        """Return at once."""
        self.waited_s.append(timeout)
        if len(self.waited_s) >= self._waits:
            self.set()
        return self.is_set()


class ScriptedOdometry:
    """Answers with one estimate after another, then with good ones at the origin."""

    def __init__(self, *estimates: Estimate) -> None:
        self.frames: list[RgbdFrame] = []
        self._estimates = list(estimates)

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """The next one."""
        self.frames.append(frame)
        return self._estimates.pop(0) if self._estimates else good_estimate(np.eye(4))


class CollectingOutput:
    """An output that keeps everything it is told, in order."""

    warning = ""

    def __init__(self) -> None:
        self.poses: list[OdometryUpdate] = []
        self.statuses: list[Status] = []
        self.closed = 0

    def on_update(self, update: OdometryUpdate) -> None:
        """Keep it."""
        self.poses.append(update)

    def on_status(self, status: Status) -> None:
        """Keep it."""
        self.statuses.append(status)

    def close(self) -> None:
        """Count it."""
        self.closed += 1

"""Statistics of the service: counts and times since the start, which the status reports."""

import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import islice
from statistics import fmean, median, pstdev

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.types.estimate import OnlineFocalLength, OnlineTiming
from vo_service.types.failure_reasons import FailureReasons
from vo_service.types.messages import LatencyReport
from vo_service.types.odometry_update import OdometryUpdate

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

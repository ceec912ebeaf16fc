"""Statistics of the loop, and load shedding: while it is late, the viewers are paused."""

import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from statistics import fmean, median, pstdev

import numpy as np

from drivers.camera import RgbdFrame
from vo_service.config_tables import LoadConfig
from vo_service.types import OdometryUpdate, OnlineFocalLength, OnlineTiming
from vo_service.types.messages import TimingReport
from vo_service.types.outputs import PausableViewer

logger = logging.getLogger(__name__)

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
        timing: The sensor's timing at the last frame; None if it is taken as exact.
    """

    now_s: Callable[[], float] = time.monotonic
    frames: int = 0
    failed: int = 0
    out_of_order: int = 0
    start_s: float | None = None
    end_s: float = 0.0
    _latency_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    _skew_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    _interval_ms: deque[float] = field(default_factory=lambda: deque(maxlen=WINDOW_FRAMES))
    timing: OnlineTiming | None = None
    focal_length: OnlineFocalLength | None = None
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
            update: The update of the frame.
            cpu_ms: CPU time of the odometry for it, ms.
        """
        self.frames += 1
        self.failed += not update.estimate.ok
        self.timing = update.estimate.timing
        self.focal_length = update.estimate.focal_length
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

    def make_timing_report(self, stage_budget_ms: Mapping[str, float]) -> TimingReport:
        """Make the report of the last seconds. All times are 0 before the first frame.

        Args:
            stage_budget_ms: Budget by stage, ms, copied into the report.
        """
        p50, p99 = np.percentile(list(self._latency_ms) or [0.0], (50, 99))
        return TimingReport(
            fps=self._recent_fps(),
            latency_p50_ms=float(p50),
            latency_p99_ms=float(p99),
            cpu_ms_per_frame=_recent_median(self._cpu_ms),
            stage_ms={stage: _recent_median(spent) for stage, spent in self._stages_ms.items()},
            stage_mean_ms={stage: self._recent_mean_ms(stage) for stage in self._stages_ms},
            stage_budget_ms=stage_budget_ms,
        )

    def _recent_mean_ms(self, stage: str) -> float:
        return fmean(spent_ms.get(stage, 0.0) for spent_ms in self._recent_stages_ms)

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


# The load is an exponential mean with this time constant. The first frames after a start are not
# counted: kernels are loaded.
TIME_CONSTANT_S, STARTUP_S = 2.0, 3.0
# Upper bound of one frame's load, in frame intervals: one slow frame is not overload.
MAX_FRAME_LOAD = 2.0
# Pause above the first; resume when the load has been below the second for a while.
MAX_LOAD, MAX_LOAD_TO_RESUME = 0.8, 0.6
# Each pause takes at least twice as long as the last one, unless the viewer ran long in between.
MIN_PAUSE_S, MAX_PAUSE_S, LONG_RUN_S = 10.0, 600.0, 60.0
# Time without frames (no camera, a pause) does not count as low load.
MAX_IDLE_S = 1.0


class LoadShedder:
    """Pauses the viewers while the loop has no time left between frames.

    Args:
        viewers: Viewers to pause; without one it does nothing.
        now_s: The clock, s.
    """

    def __init__(
        self, viewers: Sequence[PausableViewer], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._viewers, self._now_s = viewers, now_s
        self._is_enabled, self._is_paused = True, False
        self._load, self._dropped = 0.0, 0
        self._counted_since_s, self._last_s = math.inf, -math.inf
        self._low_since_s, self._resumed_s = math.inf, -math.inf
        self._pause_s = MIN_PAUSE_S

    @property
    def warning(self) -> str:
        """Why the viewer is paused; "" if it is not."""
        return "the machine is too slow: the viewer is paused" if self._is_paused else ""

    def configure(self, settings: LoadConfig) -> None:
        """Apply new settings; the viewers run again."""
        self._is_enabled = settings.adapt
        self._set_paused(False)

    def add_frame(self, busy_s: float, interval_s: float, dropped: int) -> None:
        """Add the last frame, and pause or resume the viewers if necessary.

        Args:
            busy_s: Time from its arrival in the loop to the end of its processing, s.
            interval_s: The camera's frame interval, s; 0 while unknown.
            dropped: Number of frames dropped since the start because the loop was late.
        """
        has_dropped, self._dropped = dropped > self._dropped, dropped
        if not (self._is_enabled and self._viewers and interval_s > 0.0):
            return
        now_s = self._now_s()
        if now_s - busy_s - self._last_s > MAX_IDLE_S:
            self._counted_since_s, self._low_since_s = now_s + STARTUP_S, math.inf
        self._last_s = now_s
        if now_s < self._counted_since_s:
            return
        share = min(busy_s / interval_s, MAX_FRAME_LOAD)
        share = max(share, 1.0) if has_dropped else share
        self._load += min(1.0, interval_s / TIME_CONSTANT_S) * (share - self._load)
        if self._load > MAX_LOAD:
            self._pause(now_s)
        elif self._is_paused:
            self._resume_if_due(now_s)

    def _pause(self, now_s: float) -> None:
        self._low_since_s = math.inf
        if not self._is_paused:
            had_long_run = now_s - self._resumed_s > LONG_RUN_S
            self._pause_s = MIN_PAUSE_S if had_long_run else min(2 * self._pause_s, MAX_PAUSE_S)
            self._set_paused(True)
            logger.warning("%s", self.warning)

    def _resume_if_due(self, now_s: float) -> None:
        if self._load >= MAX_LOAD_TO_RESUME:
            self._low_since_s = math.inf
            return
        self._low_since_s = min(self._low_since_s, now_s)
        if now_s - self._low_since_s >= self._pause_s:
            self._resumed_s = now_s
            self._set_paused(False)
            logger.warning("the load is low again: the viewer draws")

    def _set_paused(self, is_paused: bool) -> None:
        self._is_paused, self._low_since_s = is_paused, math.inf
        for viewer in self._viewers:
            viewer.set_paused(is_paused)

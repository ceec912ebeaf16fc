"""Load shedding: pause the viewer, then reduce features, before frames are dropped.

Each step is restored, one at a time, after the load has been low for a while.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from vo_service.config_tables import LoadConfig
from vo_service.types import HasWarning, Odometry, PausableViewer

logger = logging.getLogger(__name__)

# Shares of the full feature count, tried before the minimum.
FEATURE_SHARES = (0.7, 0.5)
# The load is a mean over this long, and over at least this many frames.
WINDOW_S, MIN_FRAMES = 2.0, 10
# Upper bound of one frame's load, in frame intervals: one slow frame is not overload.
MAX_FRAME_LOAD = 2.0
# After this long without frames (no camera, a pause), old measurements are discarded.
MAX_IDLE_S = 1.0
# Degrade above the first, restore below the second. One step of features changes the load by less
# than the gap between them.
MAX_LOAD, MAX_LOAD_TO_RESTORE = 0.8, 0.6
# This many late frames within two seconds degrade at once, whatever the mean load.
LATE_FRAMES_TO_DEGRADE = 3
# Measurements are ignored for this long after a start and after a change of level.
STARTUP_S, SETTLE_S = 3.0, 0.5
# The load must be low for this long before a restore. The wait doubles each time a restore fails:
# when the same step must be degraded again soon after it.
MIN_RESTORE_WAIT_S, MAX_RESTORE_WAIT_S = 10.0, 600.0
RESTORE_FAILED_WITHIN_S = 30.0


@dataclass(frozen=True)
class EffortLevel:
    """Amount of work per frame.

    Attributes:
        is_viewer_paused: Whether the viewer is paused.
        feature_count: Number of features to find in a frame.
    """

    is_viewer_paused: bool
    feature_count: int


def effort_levels(feature_count: int, min_features: int, has_viewer: bool) -> list[EffortLevel]:
    """List the levels from full to least effort: first pause the viewer, then reduce features.

    Args:
        feature_count: Number of features at full effort.
        min_features: Least number of features.
        has_viewer: Whether there is a viewer to pause.
    """
    fewer = [round(share * feature_count) for share in FEATURE_SHARES]
    counts = [
        feature_count,
        *(count for count in fewer if count > min_features),
        *([min_features] * (min_features < feature_count)),
    ]
    full = [EffortLevel(False, feature_count)] if has_viewer else []
    return full + [EffortLevel(has_viewer, count) for count in counts]


@dataclass(frozen=True)
class FrameCost:
    """Cost of one frame in the loop.

    Attributes:
        busy_s: Wall time from the frame's arrival in the loop to the end of its processing, s.
        cpu_s: CPU time of the same, s.
        interval_s: The camera's frame interval, s; 0 while unknown.
        dropped: Number of frames dropped since the start because the loop was late.
    """

    busy_s: float
    cpu_s: float
    interval_s: float
    dropped: int


@dataclass(frozen=True)
class _FrameLoad:
    """One frame's wall time and CPU time as shares of the frame interval.

    Attributes:
        at_s: End of its processing, s.
        busy: Wall time, as a share.
        cpu: CPU time, as a share.
        was_late: Whether frames before it were dropped.
    """

    at_s: float
    busy: float
    cpu: float
    was_late: bool


class LoadMeter:
    """Mean busy time over the last seconds, as a share of the frame interval.

    A mean, not a median: under a CPU quota most frames are fast and every third waits long.
    """

    def __init__(self) -> None:
        self._frames: deque[_FrameLoad] = deque()
        self._first_s: float | None = None
        self._last_s = 0.0
        self._dropped: int | None = None

    def add(self, load: FrameCost, now_s: float) -> None:
        """Add one frame whose processing ended at `now_s`."""
        if now_s - load.busy_s - self._last_s > MAX_IDLE_S:
            self.clear()
        self._last_s = now_s
        has_dropped = self._dropped is not None and load.dropped > self._dropped
        self._dropped = load.dropped
        if load.interval_s > 0.0:
            self._first_s = now_s if self._first_s is None else self._first_s
            share = min(load.busy_s / load.interval_s, MAX_FRAME_LOAD)
            # A drop means full load, however fast the other frames are.
            busy = max(share, 1.0) if has_dropped else share
            self._frames.append(_FrameLoad(now_s, busy, load.cpu_s / load.interval_s, has_dropped))
            self._drop_old(now_s)

    def _drop_old(self, now_s: float) -> None:
        while len(self._frames) > MIN_FRAMES and now_s - self._frames[0].at_s > WINDOW_S:
            self._frames.popleft()

    def clear(self) -> None:
        """Discard all measurements."""
        self._frames.clear()
        self._first_s = None

    @property
    def load(self) -> float | None:
        """Mean load: 1.0 = always busy, more = late. None until there are enough frames."""
        if self._first_s is None or self._last_s - self._first_s < WINDOW_S:
            return None
        if len(self._frames) < MIN_FRAMES:
            return None
        return sum(share.busy for share in self._frames) / len(self._frames)

    @property
    def late_frames(self) -> int:
        """Number of frames of the last seconds that follow a drop; one delay counts once."""
        return sum(share.was_late for share in self._frames)

    @property
    def is_starved_of_cpu(self) -> bool:
        """Whether most of the busy time was spent waiting for the CPU."""
        busy, cpu = (sum(getattr(s, name) for s in self._frames) for name in ("busy", "cpu"))
        return bool(cpu < 0.5 * busy)


@runtime_checkable
class HasFeatureCount(Protocol):
    """An odometry whose cost grows with its number of features."""

    feature_count: int


class LoadShedder(HasWarning, Protocol):
    """Adapts the effort to the machine's speed. Its warning names the reductions."""

    def add_frame(self, load: FrameCost) -> None:
        """Add the cost of the last frame and change the effort if necessary."""
        ...

    def restore_all(self) -> None:
        """Restore full effort."""
        ...


class NullLoadShedder:
    """Null load shedder: full effort, for recordings, whose results must be repeatable."""

    warning = ""

    def add_frame(self, load: FrameCost) -> None:
        """Ignore the cost."""

    def restore_all(self) -> None:
        """Do nothing: effort is always full."""


class StepwiseLoadShedder:
    """Degrades by one level when the load is high, restores one level after a time of low load."""

    def __init__(
        self,
        settings: LoadConfig,
        viewers: Sequence[PausableViewer],
        odometry: HasFeatureCount,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """Start at full effort.

        Args:
            settings: Gives the least number of features.
            viewers: Viewers to pause.
            odometry: Its present feature count is full effort.
            now_s: The clock, s.
        """
        self._viewers, self._odometry, self._now_s = viewers, odometry, now_s
        self._levels = effort_levels(odometry.feature_count, settings.min_features, bool(viewers))
        self._level = 0
        self._meter = LoadMeter()
        self._settled_s: float | None = None
        self._low_load_since_s: float | None = None
        # For each level: the wait before it is restored, and the time of the last restore.
        self._wait_s = [MIN_RESTORE_WAIT_S] * len(self._levels)
        self._restored_s = [-RESTORE_FAILED_WITHIN_S] * len(self._levels)
        self._cause = ""

    @property
    def effort(self) -> EffortLevel:
        """The present effort level."""
        return self._levels[self._level]

    @property
    def warning(self) -> str:
        """What is reduced and why, in one clause; "" at full effort."""
        degradations = ", ".join(self._degradations())
        return f"{self._cause}: {degradations}" if degradations else ""

    def add_frame(self, load: FrameCost) -> None:
        """Add the cost of the last frame and change the effort if necessary."""
        now_s = self._now_s()
        self._meter.add(load, now_s)
        if self._settled_s is None:
            self._settled_s = now_s + STARTUP_S
        if now_s < self._settled_s:
            self._meter.clear()
            return
        if self._is_overloaded():
            self._degrade(now_s)
        elif self._level > 0 and self._can_restore(now_s):
            self._restore(now_s)

    def restore_all(self) -> None:
        """Restore full effort at once and discard all measurements."""
        self._set_level(0, self._now_s())

    def _is_overloaded(self) -> bool:
        load = self._meter.load
        return self._meter.late_frames >= LATE_FRAMES_TO_DEGRADE or (load or 0.0) > MAX_LOAD

    def _can_restore(self, now_s: float) -> bool:
        load = self._meter.load
        if load is None or load >= MAX_LOAD_TO_RESTORE:
            self._low_load_since_s = None
            return False
        self._low_load_since_s = now_s if self._low_load_since_s is None else self._low_load_since_s
        return now_s - self._low_load_since_s >= self._wait_s[self._level - 1]

    def _degrade(self, now_s: float) -> None:
        self._low_load_since_s = None
        if self._level == len(self._levels) - 1:
            return
        has_failed = now_s - self._restored_s[self._level] < RESTORE_FAILED_WITHIN_S
        wait_s = 2.0 * self._wait_s[self._level] if has_failed else MIN_RESTORE_WAIT_S
        self._wait_s[self._level] = min(wait_s, MAX_RESTORE_WAIT_S)
        is_starved = self._meter.is_starved_of_cpu
        self._cause = (
            "the odometry gets too little CPU time" if is_starved else "the machine is too slow"
        )
        self._set_level(self._level + 1, now_s)
        logger.warning("%s", self.warning)

    def _restore(self, now_s: float) -> None:
        self._restored_s[self._level - 1] = now_s
        self._set_level(self._level - 1, now_s)
        remaining = ", ".join(self._degradations())
        logger.warning("the load is low again%s", f"; still: {remaining}" if remaining else "")

    def _set_level(self, level: int, now_s: float) -> None:
        self._level = level
        self._settled_s, self._low_load_since_s = now_s + SETTLE_S, None
        self._meter.clear()
        for viewer in self._viewers:
            viewer.set_paused(self.effort.is_viewer_paused)
        self._odometry.feature_count = self.effort.feature_count

    def _degradations(self) -> Iterator[str]:
        if self.effort.is_viewer_paused:
            yield "the viewer is paused"
        if self.effort.feature_count < self._levels[0].feature_count:
            yield f"{self.effort.feature_count} features"


class _FixedFeatureCount:
    """Feature count of an odometry without features."""

    feature_count = 0


class ReconfigurableLoadShedder:
    """A load shedder whose settings may change while it runs."""

    def __init__(self, viewers: Sequence[PausableViewer], odometry: Odometry) -> None:
        """Start as a null load shedder until `configure`.

        Args:
            viewers: Viewers to pause.
            odometry: Its features are reduced, if it has a feature count.
        """
        self._viewers = viewers
        self._odometry = odometry if isinstance(odometry, HasFeatureCount) else _FixedFeatureCount()
        self._load_shedder: LoadShedder = NullLoadShedder()

    @property
    def warning(self) -> str:
        """What is reduced and why; "" at full effort."""
        return self._load_shedder.warning

    def configure(self, settings: LoadConfig, feature_count: int) -> None:
        """Apply new settings and restart at full effort.

        Args:
            settings: The settings.
            feature_count: Number of features at full effort.
        """
        self._load_shedder.restore_all()
        self._odometry.feature_count = feature_count
        self._load_shedder = NullLoadShedder()
        if settings.adapt:
            self._load_shedder = StepwiseLoadShedder(settings, self._viewers, self._odometry)

    def add_frame(self, load: FrameCost) -> None:
        """Add the cost of the last frame and change the effort if necessary."""
        self._load_shedder.add_frame(load)

    def restore_all(self) -> None:
        """Restore full effort."""
        self._load_shedder.restore_all()

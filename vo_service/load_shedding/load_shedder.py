"""When the machine is too slow: give up the viewer first, then features, before frames are missed.

And take them back, one after the other, when there has been room for a while.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, runtime_checkable

from vo_service.config_tables import LoadConfig
from vo_service.load_shedding.effort_levels import EffortLevel, effort_levels
from vo_service.load_shedding.load_meter import FrameCost, LoadMeter
from vo_service.types import HasWarning, Odometry, PausableViewer

# Busier than this, something is given up; with less to do than that, it is taken back. A step of
# features changes the cost by less than what lies between.
MAX_LOAD, MAX_LOAD_TO_RESTORE = 0.8, 0.6
# So many frames within two seconds with dropped ones before them: not to be waited for.
LATE_FRAMES_TO_DEGRADE = 3
# The first seconds of a start say nothing; nor does the moment after a change.
STARTUP_S, SETTLE_S = 3.0, 0.5
# How long there must be room before something is taken back: longer each time that this failed,
# which is when it had to be given up again so soon.
MIN_RESTORE_WAIT_S, MAX_RESTORE_WAIT_S = 10.0, 600.0
RESTORE_FAILED_WITHIN_S = 30.0

logger = logging.getLogger(__name__)


@runtime_checkable
class HasFeatureCount(Protocol):
    """An odometry whose work grows with the features that it looks for."""

    feature_count: int


class LoadShedder(HasWarning, Protocol):
    """Decides how much effort the machine can bear; what is given up is its warning."""

    def add_frame(self, load: FrameCost) -> None:
        """Take what the last frame cost."""
        ...

    def restore_all(self) -> None:
        """Give everything back."""
        ...


class NullLoadShedder:
    """Never gives anything up: for recordings, whose results must not depend on the machine."""

    warning = ""

    def add_frame(self, load: FrameCost) -> None:
        """Nothing."""

    def restore_all(self) -> None:
        """Nothing was given up."""


class StepwiseLoadShedder:
    """Goes down a step when the loop is too busy, up one when there has been room for a while."""

    def __init__(
        self,
        settings: LoadConfig,
        viewers: Sequence[PausableViewer],
        odometry: HasFeatureCount,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """The odometry's feature count of now is the full one."""
        self._viewers, self._odometry, self._now_s = viewers, odometry, now_s
        self._levels = effort_levels(odometry.feature_count, settings.min_features, bool(viewers))
        self._level = 0
        self._meter = LoadMeter()
        self._settled_s: float | None = None
        self._low_load_since_s: float | None = None
        # For each step, how long to wait before it is tried again, and when it last was.
        self._wait_s = [MIN_RESTORE_WAIT_S] * len(self._levels)
        self._restored_s = [-RESTORE_FAILED_WITHIN_S] * len(self._levels)
        self._cause = ""

    @property
    def effort(self) -> EffortLevel:
        """What is done now."""
        return self._levels[self._level]

    @property
    def warning(self) -> str:
        """What is given up and why, in a clause; "" while nothing is."""
        given_up = ", ".join(self._degradations())
        return f"{self._cause}: {given_up}" if given_up else ""

    def add_frame(self, load: FrameCost) -> None:
        """Take what the last frame cost, and change the effort where that is called for."""
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
        """Give everything back at once and begin anew."""
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
        waits = self._meter.is_starved_of_cpu
        self._cause = (
            "the odometry gets too little of the processor" if waits else "the machine is too slow"
        )
        self._set_level(self._level + 1, now_s)
        logger.warning("%s", self.warning)

    def _restore(self, now_s: float) -> None:
        self._restored_s[self._level - 1] = now_s
        self._set_level(self._level - 1, now_s)
        still = ", ".join(self._degradations())
        logger.warning("there is room again%s", f"; still: {still}" if still else "")

    def _set_level(self, level: int, now_s: float) -> None:
        self._level = level
        self._settled_s, self._low_load_since_s = now_s + SETTLE_S, None
        self._meter.clear()
        for viewer in self._viewers:
            viewer.set_paused(self.effort.is_viewer_paused)
        self._odometry.feature_count = self.effort.feature_count

    def _degradations(self) -> Iterator[str]:
        if self.effort.is_viewer_paused:
            yield "the viewer rests"
        if self.effort.feature_count < self._levels[0].feature_count:
            yield f"{self.effort.feature_count} features"


class _FixedFeatureCount:
    """Stands in for an odometry that looks for none."""

    feature_count = 0


class ReconfigurableLoadShedder:
    """A governor that is made anew whenever its settings change."""

    def __init__(self, viewers: Sequence[PausableViewer], odometry: Odometry) -> None:
        """An odometry without features can give nothing up."""
        self._viewers = viewers
        self._odometry = odometry if isinstance(odometry, HasFeatureCount) else _FixedFeatureCount()
        self._load_shedder: LoadShedder = NullLoadShedder()

    @property
    def warning(self) -> str:
        """What is given up."""
        return self._load_shedder.warning

    def configure(self, settings: LoadConfig, feature_count: int) -> None:
        """Begin with all the effort: so many features, and the viewers at work."""
        self._load_shedder.restore_all()
        self._odometry.feature_count = feature_count
        self._load_shedder = NullLoadShedder()
        if settings.adapt:
            self._load_shedder = StepwiseLoadShedder(settings, self._viewers, self._odometry)

    def add_frame(self, load: FrameCost) -> None:
        """See `LoadShedder`."""
        self._load_shedder.add_frame(load)

    def restore_all(self) -> None:
        """See `LoadShedder`."""
        self._load_shedder.restore_all()

"""When the machine is too slow: give up the viewer first, then features, before frames are missed.

And take them back, one after the other, when there has been room for a while.
"""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, runtime_checkable

from vo_service.load.effort import Effort, efforts
from vo_service.load.meter import FrameLoad, LoadMeter
from vo_service.settings import LoadSettings
from vo_service.types import Troubled, Viewer

# Busier than this, something is given up; with less to do than that, it is taken back. A step of
# features changes the cost by less than what lies between.
TOO_BUSY, ROOM = 0.8, 0.6
# So many frames within two seconds with dropped ones before them: not to be waited for.
LATE_FRAMES = 3
# The first seconds of a start say nothing; nor does the moment after a change.
START_S, SETTLE_S = 3.0, 0.5
# How long there must be room before something is taken back: longer each time that this failed,
# which is when it had to be given up again so soon.
FIRST_WAIT_S, LONGEST_WAIT_S = 10.0, 600.0
SOON_S = 30.0

logger = logging.getLogger(__name__)


@runtime_checkable
class FeatureUser(Protocol):
    """An odometry whose work grows with the features that it looks for."""

    feature_count: int


class Governor(Troubled, Protocol):
    """Decides how much effort the machine can bear; what is given up is its warning."""

    def frame(self, load: FrameLoad) -> None:
        """Take what the last frame cost."""
        ...

    def release(self) -> None:
        """Give everything back."""
        ...


class FixedEffort:
    """Never gives anything up: for recordings, whose results must not depend on the machine."""

    warning = ""

    def frame(self, load: FrameLoad) -> None:
        """Nothing."""

    def release(self) -> None:
        """Nothing was given up."""


class LoadGovernor:
    """Goes down a step when the loop is too busy, up one when there has been room for a while."""

    def __init__(
        self,
        settings: LoadSettings,
        viewers: Sequence[Viewer],
        odometry: FeatureUser,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """The odometry's feature count of now is the full one."""
        self._viewers, self._odometry, self._now_s = viewers, odometry, now_s
        self._steps = efforts(odometry.feature_count, settings.min_features, bool(viewers))
        self._at = 0
        self._meter = LoadMeter()
        self._judged_from_s: float | None = None
        self._room_since_s: float | None = None
        # For each step, how long to wait before it is tried again, and when it last was.
        self._wait_s = [FIRST_WAIT_S] * len(self._steps)
        self._tried_s = [-SOON_S] * len(self._steps)
        self._cause = ""

    @property
    def effort(self) -> Effort:
        """What is done now."""
        return self._steps[self._at]

    @property
    def warning(self) -> str:
        """What is given up and why, in a clause; "" while nothing is."""
        given_up = ", ".join(self._given_up())
        return f"{self._cause}: {given_up}" if given_up else ""

    def frame(self, load: FrameLoad) -> None:
        """Take what the last frame cost, and change the effort where that is called for."""
        now_s = self._now_s()
        self._meter.add(load, now_s)
        if self._judged_from_s is None:
            self._judged_from_s = now_s + START_S
        if now_s < self._judged_from_s:
            self._meter.clear()
            return
        if self._is_too_much():
            self._give_up(now_s)
        elif self._at > 0 and self._has_had_room(now_s):
            self._take_back(now_s)

    def release(self) -> None:
        """Give everything back at once and begin anew."""
        self._go_to(0, self._now_s())

    def _is_too_much(self) -> bool:
        load = self._meter.load
        return self._meter.late_frames >= LATE_FRAMES or (load or 0.0) > TOO_BUSY

    def _has_had_room(self, now_s: float) -> bool:
        load = self._meter.load
        if load is None or load >= ROOM:
            self._room_since_s = None
            return False
        self._room_since_s = now_s if self._room_since_s is None else self._room_since_s
        return now_s - self._room_since_s >= self._wait_s[self._at - 1]

    def _give_up(self, now_s: float) -> None:
        self._room_since_s = None
        if self._at == len(self._steps) - 1:
            return
        has_failed = now_s - self._tried_s[self._at] < SOON_S
        wait_s = 2.0 * self._wait_s[self._at] if has_failed else FIRST_WAIT_S
        self._wait_s[self._at] = min(wait_s, LONGEST_WAIT_S)
        waits = self._meter.is_waiting
        self._cause = (
            "the odometry gets too little of the processor" if waits else "the machine is too slow"
        )
        self._go_to(self._at + 1, now_s)
        logger.warning("%s", self.warning)

    def _take_back(self, now_s: float) -> None:
        self._tried_s[self._at - 1] = now_s
        self._go_to(self._at - 1, now_s)
        still = ", ".join(self._given_up())
        logger.warning("there is room again%s", f"; still: {still}" if still else "")

    def _go_to(self, step: int, now_s: float) -> None:
        self._at = step
        self._judged_from_s, self._room_since_s = now_s + SETTLE_S, None
        self._meter.clear()
        for viewer in self._viewers:
            viewer.rest(self.effort.viewer_rests)
        self._odometry.feature_count = self.effort.features

    def _given_up(self) -> Iterator[str]:
        if self.effort.viewer_rests:
            yield "the viewer rests"
        if self.effort.features < self._steps[0].features:
            yield f"{self.effort.features} features"

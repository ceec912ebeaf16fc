"""From a camera's stamps to published ones: the clock they are on, and that they only rise."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Clock

# A larger step of the wall clock than this is somebody setting it, not the network's fine tuning.
MAX_CLOCK_STEP_S = 0.05
# A camera whose stamps stay behind for this many frames has a new clock, not a glitch.
MAX_STALE_FRAMES = 15


class PublishClock(Protocol):
    """Turns a frame's stamp into the published one."""

    def published_s(self, stamp_s: float) -> float:
        """Seconds on the published clock."""
        ...

    def has_stepped(self) -> bool:
        """True once after the published clock was set."""
        ...


class RecordedClock:
    """A recording's stamps go out as they are."""

    def __init__(self, offset_s: float = 0.0) -> None:
        self._offset_s = offset_s

    def published_s(self, stamp_s: float) -> float:
        """The stamp itself, with the known bias corrected."""
        return stamp_s + self._offset_s

    def has_stepped(self) -> bool:
        """Never: a recording has one clock."""
        return False


class LiveClock:
    """CLOCK_MONOTONIC plus an offset to CLOCK_REALTIME, taken at start and after a clock step.

    Between steps, published stamps advance as evenly as the camera's own.
    """

    def __init__(
        self,
        offset_s: float = 0.0,
        monotonic_s: Callable[[], float] = time.monotonic,
        realtime_s: Callable[[], float] = time.time,
    ) -> None:
        self._offset_s = offset_s
        self._monotonic_s = monotonic_s
        self._realtime_s = realtime_s
        self._realtime_offset_s = self._measure_realtime_offset_s()

    def published_s(self, stamp_s: float) -> float:
        """Unix time of a stamp on CLOCK_MONOTONIC."""
        return stamp_s + self._realtime_offset_s + self._offset_s

    def has_stepped(self) -> bool:
        """True once after the wall clock was set by more than 50 ms."""
        epoch_s = self._measure_realtime_offset_s()
        if abs(epoch_s - self._realtime_offset_s) <= MAX_CLOCK_STEP_S:
            return False
        self._realtime_offset_s = epoch_s
        return True

    def _measure_realtime_offset_s(self) -> float:
        """CLOCK_REALTIME minus CLOCK_MONOTONIC: of three readings, the least interrupted."""
        return min(self._read_clocks() for _ in range(3))[1]

    def _read_clocks(self) -> tuple[float, float]:
        """How long the reading took (a busy machine may pause us in it), and the difference."""
        before_s, realtime_s, after_s = self._monotonic_s(), self._realtime_s(), self._monotonic_s()
        return after_s - before_s, realtime_s - 0.5 * (before_s + after_s)


def make_publish_clock(clock: Clock, offset_s: float) -> PublishClock:
    """The published clock for a camera's own."""
    return LiveClock(offset_s) if clock is Clock.MONOTONIC else RecordedClock(offset_s)


@dataclass(frozen=True)
class TimestampCheck:
    """Whether to use a frame, and whether its stamps began anew."""

    is_accepted: bool
    is_restart: bool = False


class TimestampFilter:
    """Lets only frames through whose stamps rise.

    A camera whose stamps stay behind is believed after `MAX_STALE_FRAMES` frames.
    """

    def __init__(self) -> None:
        self._last_s = float("-inf")
        self._stale = 0

    def check(self, stamp_s: float) -> TimestampCheck:
        """Judge the next frame by its stamp."""
        if stamp_s > self._last_s:
            self._last_s, self._stale = stamp_s, 0
            return TimestampCheck(is_accepted=True)
        self._stale += 1
        if self._stale < MAX_STALE_FRAMES:
            return TimestampCheck(is_accepted=False)
        self._last_s, self._stale = stamp_s, 0
        return TimestampCheck(is_accepted=True, is_restart=True)

"""Clock: convert a camera's stamps to published stamps, and reject stamps that do not increase."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import Clock

# A larger step of the wall clock than this means that it was set, not that NTP adjusted it.
MAX_CLOCK_STEP_S = 0.05
# A camera whose stamps stay behind for this many frames has a new clock, not a glitch.
MAX_STALE_FRAMES = 15


class RecordedClock:
    """Publishes a recording's stamps, plus a constant offset."""

    def __init__(self, offset_s: float = 0.0) -> None:
        self._offset_s = offset_s

    def published_s(self, stamp_s: float) -> float:
        """Add the offset to the stamp."""
        return stamp_s + self._offset_s

    def has_stepped(self) -> bool:
        """Return False: a recording has one clock."""
        return False


class LiveClock:
    """CLOCK_MONOTONIC plus its offset to CLOCK_REALTIME, measured at start and after a clock step.

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
        """Convert a stamp on CLOCK_MONOTONIC to Unix time."""
        return stamp_s + self._realtime_offset_s + self._offset_s

    def has_stepped(self) -> bool:
        """Whether the wall clock was set by more than `MAX_CLOCK_STEP_S` since the last call."""
        epoch_s = self._measure_realtime_offset_s()
        if abs(epoch_s - self._realtime_offset_s) <= MAX_CLOCK_STEP_S:
            return False
        self._realtime_offset_s = epoch_s
        return True

    def _measure_realtime_offset_s(self) -> float:
        """CLOCK_REALTIME minus CLOCK_MONOTONIC: the fastest of three readings."""
        return min(self._read_clocks() for _ in range(3))[1]

    def _read_clocks(self) -> tuple[float, float]:
        """Duration of a reading (longer if the process is interrupted in it), and the offset."""
        before_s, realtime_s, after_s = self._monotonic_s(), self._realtime_s(), self._monotonic_s()
        return after_s - before_s, realtime_s - 0.5 * (before_s + after_s)


# Converts a frame's stamp to the published stamp, s, and tells when the published clock was set.
PublishClock = RecordedClock | LiveClock


def make_publish_clock(clock: Clock, offset_s: float) -> PublishClock:
    """Make the published clock for a camera's clock.

    Args:
        clock: Clock of the camera's stamps.
        offset_s: Added to every published stamp, s.
    """
    return LiveClock(offset_s) if clock is Clock.MONOTONIC else RecordedClock(offset_s)


@dataclass(frozen=True)
class TimestampCheck:
    """Result of the check of a stamp.

    Attributes:
        is_accepted: Whether to use the frame.
        is_restart: Whether the camera's clock has restarted at this frame.
    """

    is_accepted: bool
    is_restart: bool = False


class TimestampFilter:
    """Accepts only frames whose stamps increase.

    After `MAX_STALE_FRAMES` rejected frames in a row, the camera's clock counts as restarted.
    """

    def __init__(self) -> None:
        self._last_s = float("-inf")
        self._stale = 0

    def check(self, stamp_s: float) -> TimestampCheck:
        """Check the stamp of the next frame, s on the camera's clock."""
        if stamp_s > self._last_s:
            self._last_s, self._stale = stamp_s, 0
            return TimestampCheck(is_accepted=True)
        self._stale += 1
        if self._stale < MAX_STALE_FRAMES:
            return TimestampCheck(is_accepted=False)
        self._last_s, self._stale = stamp_s, 0
        return TimestampCheck(is_accepted=True, is_restart=True)

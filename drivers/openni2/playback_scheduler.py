"""Schedules the pairs of a recording that is played."""

import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence

from drivers.camera import FrameTimeout, PlaybackMode


class PlaybackScheduler(ABC):
    """Schedules the pairs of a recording, which are numbered from 0."""

    @abstractmethod
    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        """Wait for pair `seq` or a later one that is already due; return its number.

        Raises:
            FrameTimeout: The pair is not due within `timeout_s`.
        """


def make_playback_scheduler(
    playback_mode: PlaybackMode, stamps_s: Sequence[float]
) -> PlaybackScheduler:
    """Make the scheduler of a playback mode for pairs with these stamps."""
    if playback_mode is PlaybackMode.LOCKSTEP:
        return LockstepScheduler()
    return RealtimeScheduler([stamp_s - stamps_s[0] for stamp_s in stamps_s])


class LockstepScheduler(PlaybackScheduler):
    """Delivers every pair at once when it is read."""

    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        return seq


class RealtimeScheduler(PlaybackScheduler):
    """Delivers each pair when it is due; pairs that were not read in time are dropped.

    Playback starts when the first pair is read.

    Args:
        offsets_s: Stamps relative to the first one.
        clock: Returns the time in seconds.
        sleep: Waits for a number of seconds.
    """

    def __init__(
        self,
        offsets_s: Sequence[float],
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._offsets_s, self._clock, self._sleep = offsets_s, clock, sleep
        self._start_s: float | None = None

    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        now_s = self._clock()
        if self._start_s is None:
            self._start_s = now_s
        wait_s = self._start_s + self._offsets_s[seq] - now_s
        self._sleep(max(0.0, min(wait_s, timeout_s)))
        if wait_s > timeout_s:
            raise FrameTimeout
        newest_due = bisect_right(self._offsets_s, self._clock() - self._start_s) - 1
        return max(seq, newest_due)

"""Which pair of a recording comes next, and when."""

import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable, Sequence

from drivers.camera import FrameTimeout, PlaybackMode


class PlaybackScheduler(ABC):
    """Decides for a recording whose pairs are numbered from 0."""

    @abstractmethod
    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        """Wait for pair `seq` or a later one that is due already. Raises NoFrameYet."""


def make_playback_scheduler(
    playback_mode: PlaybackMode, stamps_s: Sequence[float]
) -> PlaybackScheduler:
    """`stamps_s` are those of all pairs."""
    if playback_mode is PlaybackMode.LOCKSTEP:
        return LockstepScheduler()
    return RealtimeScheduler([stamp_s - stamps_s[0] for stamp_s in stamps_s])


class LockstepScheduler(PlaybackScheduler):
    """Every pair, when it is asked for."""

    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        """See `Pacer`."""
        return seq


class RealtimeScheduler(PlaybackScheduler):
    """Each pair when it is due, a newer one instead of it once that is due.

    `offsets_s` are the stamps since the first; the recording starts to run when the first pair is
    asked for.
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
        """See `Pacer`."""
        now_s = self._clock()
        if self._start_s is None:
            self._start_s = now_s
        wait_s = self._start_s + self._offsets_s[seq] - now_s
        self._sleep(max(0.0, min(wait_s, timeout_s)))
        if wait_s > timeout_s:
            raise FrameTimeout
        newest_due = bisect_right(self._offsets_s, self._clock() - self._start_s) - 1
        return max(seq, newest_due)

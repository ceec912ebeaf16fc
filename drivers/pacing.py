"""The pacers of a playback: they decide which frame is delivered next, and when."""

import math
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import FrameTimeout, PlaybackMode


@dataclass(frozen=True)
class HostClock:
    """The host's clock and how to wait; tests replace it."""

    now_s: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


HOST_CLOCK = HostClock()


class Pacer(ABC):
    """Decides which frame is delivered next, and when. Frames are numbered from 0.

    Attributes:
        start_s: When frame 0 was captured, s on the host's clock; infinity before `start`.
    """

    def __init__(self, host: HostClock = HOST_CLOCK) -> None:
        self.host = host
        self.start_s = math.inf

    def start(self) -> None:
        """Start the playback now, unless it has started."""
        if self.start_s == math.inf:
            self.start_s = self.host.now_s()

    def rewind(self) -> None:
        """End the playback; it can be started again."""
        self.start_s = math.inf

    @abstractmethod
    def receive_time_s(self, seq: int) -> float:
        """Return when frame `seq` is complete, s on the host's clock, after `start`."""

    @abstractmethod
    def newest_due(self, seq: int) -> int:
        """Return the frame that replaces `seq` now: itself, or a later one that is due."""

    @abstractmethod
    def seconds_until_replaced(self, seq: int) -> float:
        """Return the seconds until frame `seq` replaces those before it, at most TIMEOUT_MAX."""

    def seconds_until_due(self, seq: int) -> float:
        """Return the seconds until frame `seq` can be delivered; 0 if it can now."""
        return max(0.0, self.receive_time_s(seq) - self.host.now_s())

    def wait_until_due(self, seq: int, timeout_s: float) -> int:
        """Start if needed, wait for frame `seq`, and return the frame that replaces it by then.

        Raises:
            FrameTimeout: The frame is not due within `timeout_s`.
        """
        self.start()
        deadline_s = self.host.now_s() + timeout_s
        while (wait_s := self.seconds_until_due(seq)) > 0.0:
            left_s = deadline_s - self.host.now_s()
            if left_s <= 0.0:
                raise FrameTimeout
            self.host.sleep(min(wait_s, left_s))
        return self.newest_due(seq)


class LockstepPacer(Pacer):
    """Delivers every frame when it is read."""

    def receive_time_s(self, seq: int) -> float:
        return self.host.now_s()

    def newest_due(self, seq: int) -> int:
        return seq

    def seconds_until_replaced(self, seq: int) -> float:
        return threading.TIMEOUT_MAX


class RealtimePacer(Pacer):
    """Delivers each frame when it is due; frames that were not read in time are dropped.

    Args:
        offset_s: Returns when a frame is due, s after the start; it never falls.
    """

    def __init__(
        self, offset_s: Callable[[int], float], count: int, host: HostClock = HOST_CLOCK
    ) -> None:
        super().__init__(host)
        self._offset_s, self._count = offset_s, count

    def receive_time_s(self, seq: int) -> float:
        return self.start_s + self._offset_s(seq)

    def newest_due(self, seq: int) -> int:
        now_s, frames = self.host.now_s(), range(self._count)
        return max(seq, bisect_right(frames, now_s, key=self.receive_time_s) - 1)

    def seconds_until_replaced(self, seq: int) -> float:
        return min(self.seconds_until_due(seq), threading.TIMEOUT_MAX)


class DelayingPacer:
    """Delivers every frame, none before it is due by its stamp; a late one delays the next ones."""

    def __init__(self, host: HostClock = HOST_CLOCK) -> None:
        self._host = host
        self._due_s, self._last_stamp_s = -math.inf, 0.0

    def seconds_until_due(self, stamp_s: float) -> float:
        """Return how long to wait with the next frame."""
        now_s = self._host.now_s()
        self._due_s = max(self._due_s + stamp_s - self._last_stamp_s, now_s)
        self._last_stamp_s = stamp_s
        return self._due_s - now_s


def make_pacer(
    playback_mode: PlaybackMode,
    offset_s: Callable[[int], float],
    count: int,
    host: HostClock = HOST_CLOCK,
) -> Pacer:
    """Make the pacer of a playback mode.

    Args:
        offset_s: Returns when a frame is due, s after the start; it never falls.
    """
    if playback_mode is PlaybackMode.LOCKSTEP:
        return LockstepPacer(host)
    return RealtimePacer(offset_s, count, host)

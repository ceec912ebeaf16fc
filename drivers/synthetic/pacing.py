"""When a frame is handed over: as fast as it is taken, or as a live camera would."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from drivers.camera import Clock, FrameTimeout, PlaybackMode

FIRST_STAMP_S = 1000.0


@dataclass(frozen=True)
class HostClock:
    """The host's clock, and how to wait for it; tests bring their own."""

    now_s: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


class FramePacer(Protocol):
    """Decides which frame comes next, and when. Frame k is taken at stamp k / rate_hz."""

    clock: Clock

    @property
    def has_started(self) -> bool:
        """Whether stamps are known."""
        ...

    def rewind(self) -> None:
        """Frame 0 is taken when the next one is asked for."""
        ...

    def resume_at(self, seq: int) -> int:
        """First frame to deliver after the camera was away until frame `seq`."""
        ...

    def wait_for_frame(self, next_seq: int, last_seq: int, timeout_s: float) -> int:
        """Wait for a frame from `next_seq` to `last_seq`. Raises NoFrameYet."""
        ...

    def stamp_s(self, seq: int) -> float:
        """Stamp of a frame in whole microseconds."""
        ...

    def receive_time_s(self, seq: int) -> float:
        """CLOCK_MONOTONIC when a frame that was taken had arrived."""
        ...


def make_pacer(
    playback_mode: PlaybackMode, rate_hz: float, latency_s: float, host: HostClock
) -> FramePacer:
    """`latency_s`: from a frame's stamp until all of it has arrived."""
    if playback_mode is PlaybackMode.REALTIME:
        return RealtimeFramePacer(rate_hz, latency_s, host)
    return LockstepFramePacer(rate_hz, host)


class LockstepFramePacer:
    """Every frame, at once, under stamps that are the same in every run."""

    clock = Clock.RECORDED

    def __init__(self, rate_hz: float, host: HostClock) -> None:
        self._rate_hz = rate_hz
        self._host = host

    @property
    def has_started(self) -> bool:
        """Always: the stamps are the same in every run."""
        return True

    def rewind(self) -> None:
        """See `Pacer`."""

    def resume_at(self, seq: int) -> int:
        """See `Pacer`."""
        return seq

    def wait_for_frame(self, next_seq: int, last_seq: int, timeout_s: float) -> int:
        """See `Pacer`."""
        return next_seq

    def stamp_s(self, seq: int) -> float:
        """See `Pacer`."""
        return round(FIRST_STAMP_S + seq / self._rate_hz, 6)

    def receive_time_s(self, seq: int) -> float:
        """See `Pacer`."""
        return self._host.now_s()


class RealtimeFramePacer:
    """A live camera: the newest frame that has arrived; older ones are gone."""

    clock = Clock.MONOTONIC

    def __init__(self, rate_hz: float, latency_s: float, host: HostClock) -> None:
        self._rate_hz = rate_hz
        self._latency_s = latency_s
        self._host = host
        self._start_s = 0.0
        self._has_started = False

    @property
    def has_started(self) -> bool:
        """From the first `take` on."""
        return self._has_started

    def rewind(self) -> None:
        """See `Pacer`."""
        self._has_started = False

    def resume_at(self, seq: int) -> int:
        """See `Pacer`."""
        return max(seq, self._newest() + 1)

    def wait_for_frame(self, next_seq: int, last_seq: int, timeout_s: float) -> int:
        """See `Pacer`."""
        if not self._has_started:
            self._start_s, self._has_started = self._host.now_s(), True
        due_s = self.receive_time_s(next_seq)
        deadline_s = self._host.now_s() + timeout_s
        while (now_s := self._host.now_s()) < due_s:
            if now_s >= deadline_s:
                raise FrameTimeout
            self._host.sleep(min(due_s, deadline_s) - now_s)
        return max(next_seq, min(self._newest(), last_seq))

    def stamp_s(self, seq: int) -> float:
        """See `Pacer`."""
        return round(self._start_s + seq / self._rate_hz, 6)

    def receive_time_s(self, seq: int) -> float:
        """See `Pacer`."""
        return self.stamp_s(seq) + self._latency_s

    def _newest(self) -> int:
        age_s = self._host.now_s() - self._start_s - self._latency_s
        return int(age_s * self._rate_hz // 1)

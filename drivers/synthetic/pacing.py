"""When a frame is delivered: as fast as it is read, or as a live camera would."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from drivers.camera import Clock, FrameTimeout, PlaybackMode

FIRST_STAMP_S = 1000.0


@dataclass(frozen=True)
class HostClock:
    """The host's clock and how to wait; tests replace it."""

    now_s: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


class LockstepFramePacer:
    """Delivers every frame at once, with stamps that are the same in every run."""

    clock = Clock.RECORDED
    has_started = True  # whether stamps are known

    def __init__(self, rate_hz: float, host: HostClock) -> None:
        self._rate_hz = rate_hz
        self._host = host

    def rewind(self) -> None:
        """Start again: the next frame read is frame 0."""

    def resume_at(self, seq: int) -> int:
        """Return the first frame to deliver after the camera was away until frame `seq`."""
        return seq

    def wait_for_frame(self, next_seq: int, last_seq: int, timeout_s: float) -> int:
        """Wait for a frame from `next_seq` to `last_seq`.

        Args:
            next_seq: Number of the next frame.
            last_seq: Number of the last frame of the sequence.
            timeout_s: Longest wait, s.

        Raises:
            FrameTimeout: If there is none in time.
        """
        return next_seq

    def stamp_s(self, seq: int) -> float:
        """Stamp of a frame in whole microseconds."""
        return round(FIRST_STAMP_S + seq / self._rate_hz, 6)

    def receive_time_s(self, seq: int) -> float:
        """CLOCK_MONOTONIC at which a frame arrived completely."""
        return self._host.now_s()


class RealtimeFramePacer:
    """Delivers the newest frame that has arrived, like a live camera; older ones are dropped."""

    clock = Clock.MONOTONIC

    def __init__(self, rate_hz: float, latency_s: float, host: HostClock) -> None:
        self._rate_hz = rate_hz
        self._latency_s = latency_s
        self._host = host
        self._start_s = 0.0
        self.has_started = False  # until the first `wait_for_frame`

    def rewind(self) -> None:
        self.has_started = False

    def resume_at(self, seq: int) -> int:
        return max(seq, self._newest() + 1)

    def wait_for_frame(self, next_seq: int, last_seq: int, timeout_s: float) -> int:
        if not self.has_started:
            self._start_s, self.has_started = self._host.now_s(), True
        due_s = self.receive_time_s(next_seq)
        deadline_s = self._host.now_s() + timeout_s
        while (now_s := self._host.now_s()) < due_s:
            if now_s >= deadline_s:
                raise FrameTimeout
            self._host.sleep(min(due_s, deadline_s) - now_s)
        return max(next_seq, min(self._newest(), last_seq))

    def stamp_s(self, seq: int) -> float:
        return round(self._start_s + seq / self._rate_hz, 6)

    def receive_time_s(self, seq: int) -> float:
        return self.stamp_s(seq) + self._latency_s

    def _newest(self) -> int:
        age_s = self._host.now_s() - self._start_s - self._latency_s
        return int(age_s * self._rate_hz // 1)


# Decides which frame is delivered next, and when. Frame k has the stamp k / rate_hz.
FramePacer = LockstepFramePacer | RealtimeFramePacer


def make_pacer(
    playback_mode: PlaybackMode, rate_hz: float, latency_s: float, host: HostClock
) -> FramePacer:
    """Make the pacer of a mode; `latency_s` is from a frame's stamp until all of it has arrived.

    Args:
        playback_mode: Lockstep or real time.
        rate_hz: Frames a second.
        latency_s: Time from a frame's stamp until all of it has arrived, s.
        host: The computer's clock.
    """
    if playback_mode is PlaybackMode.REALTIME:
        return RealtimeFramePacer(rate_hz, latency_s, host)
    return LockstepFramePacer(rate_hz, host)

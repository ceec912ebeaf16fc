"""When the pairs of a recording are handed over."""

import pytest

from drivers.camera import FrameTimeout, PlaybackMode
from drivers.openni2.playback_scheduler import RealtimeScheduler, make_playback_scheduler


class PlayedTime:
    """A clock that moves only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


def pacer(time: PlayedTime) -> RealtimeScheduler:
    return RealtimeScheduler([0.0, 0.1, 0.2, 0.3], lambda: time.now_s, time.sleep)


def test_lockstep_never_waits_and_skips_nothing() -> None:
    lockstep = make_playback_scheduler(PlaybackMode.LOCKSTEP, [0.0, 1e6])
    assert [lockstep.wait_until_due(seq, 0.0) for seq in (0, 1)] == [0, 1]


def test_playback_starts_with_the_first_read() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    time.now_s += 5.0
    assert realtime.wait_until_due(0, 1.0) == 0
    assert time.now_s == 105.0


def test_waits_until_a_pair_is_due() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    assert [realtime.wait_until_due(seq, 1.0) for seq in range(4)] == [0, 1, 2, 3]
    assert time.now_s == pytest.approx(100.3)


def test_newest_due_pair_replaces_older_ones() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    realtime.wait_until_due(0, 1.0)
    time.now_s += 0.25
    assert realtime.wait_until_due(1, 1.0) == 2


def test_waiting_never_exceeds_the_timeout() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    realtime.wait_until_due(0, 1.0)
    with pytest.raises(FrameTimeout):
        realtime.wait_until_due(1, 0.04)
    assert time.now_s == pytest.approx(100.04)
    assert realtime.wait_until_due(1, 1.0) == 1


def test_stamps_count_from_the_first() -> None:
    realtime = make_playback_scheduler(PlaybackMode.REALTIME, [1e9, 1e9 + 60.0])
    assert realtime.wait_until_due(0, 1.0) == 0
    with pytest.raises(FrameTimeout):
        realtime.wait_until_due(1, 0.0)

"""When the pairs of a recording are handed over."""

import pytest

from drivers.camera import NoFrameYet, Pace
from drivers.openni2.pace import RealtimePacer, make_pacer


class PlayedTime:
    """A clock that moves only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


def pacer(time: PlayedTime) -> RealtimePacer:
    return RealtimePacer([0.0, 0.1, 0.2, 0.3], lambda: time.now_s, time.sleep)


def test_lockstep_never_waits_and_leaves_nothing_out() -> None:
    lockstep = make_pacer(Pace.LOCKSTEP, [0.0, 1e6])
    assert [lockstep.take(seq, 0.0) for seq in (0, 1)] == [0, 1]


def test_recording_begins_to_run_when_it_is_first_read() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    time.now_s += 5.0
    assert realtime.take(0, 1.0) == 0
    assert time.now_s == 105.0


def test_waits_until_a_pair_is_due() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    assert [realtime.take(seq, 1.0) for seq in range(4)] == [0, 1, 2, 3]
    assert time.now_s == pytest.approx(100.3)


def test_newest_pair_that_is_due_replaces_older_ones() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    realtime.take(0, 1.0)
    time.now_s += 0.25
    assert realtime.take(1, 1.0) == 2


def test_never_waits_longer_than_it_was_told() -> None:
    time = PlayedTime()
    realtime = pacer(time)
    realtime.take(0, 1.0)
    with pytest.raises(NoFrameYet):
        realtime.take(1, 0.04)
    assert time.now_s == pytest.approx(100.04)
    assert realtime.take(1, 1.0) == 1


def test_stamps_count_from_the_first() -> None:
    realtime = make_pacer(Pace.REALTIME, [1e9, 1e9 + 60.0])
    assert realtime.take(0, 1.0) == 0
    with pytest.raises(NoFrameYet):
        realtime.take(1, 0.0)

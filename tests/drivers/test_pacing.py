"""Which frame of a playback is delivered next, and when."""

import sys

import pytest

from drivers.camera import FrameTimeout, PlaybackMode
from drivers.pacing import DelayingPacer, HostClock, Pacer, make_pacer
from tests.drivers.fake_host import FakeHost


def make_realtime(host: FakeHost, count: int = 20) -> Pacer:
    """Frames that are due every 0.1 s."""
    return make_pacer(PlaybackMode.REALTIME, lambda seq: seq / 10, count, host.clock)


def test_lockstep_never_waits_and_skips_nothing() -> None:
    lockstep = make_pacer(PlaybackMode.LOCKSTEP, lambda seq: 1e6 * seq, 2)
    assert [lockstep.wait_until_due(seq, 0.0) for seq in (0, 1)] == [0, 1]


def test_playback_starts_with_the_first_read() -> None:
    host = FakeHost()
    realtime = make_realtime(host)
    host.sleep(5.0)
    assert realtime.newest_due(1) == 1
    assert realtime.wait_until_due(0, 1.0) == 0
    assert host.now_s == realtime.start_s == 5005.0
    realtime.rewind()
    host.sleep(5.0)
    assert realtime.wait_until_due(0, 1.0) == 0


@pytest.mark.parametrize("count", [4, sys.maxsize])
def test_waits_until_a_frame_is_due(count: int) -> None:
    host = FakeHost()
    realtime = make_realtime(host, count)
    assert [realtime.wait_until_due(seq, 1.0) for seq in range(4)] == [0, 1, 2, 3]
    assert host.now_s == pytest.approx(5000.3)


def test_the_newest_due_frame_replaces_older_ones_up_to_the_last() -> None:
    host = FakeHost()
    realtime = make_realtime(host)
    realtime.wait_until_due(0, 1.0)
    host.sleep(0.25)
    assert realtime.wait_until_due(1, 1.0) == 2
    host.sleep(1000.0)
    assert (realtime.newest_due(3), realtime.newest_due(20)) == (19, 20)


def test_waiting_never_exceeds_the_timeout() -> None:
    host = FakeHost()
    realtime = make_realtime(host)
    realtime.wait_until_due(0, 1.0)
    with pytest.raises(FrameTimeout):
        realtime.wait_until_due(1, 0.04)
    assert host.now_s == pytest.approx(5000.04)
    assert realtime.wait_until_due(1, 1.0) == 1


def test_a_sleep_that_ends_early_is_continued() -> None:
    host = FakeHost()
    clock = HostClock(lambda: host.now_s, lambda seconds: host.sleep(max(seconds / 2, 1e-3)))
    realtime = make_pacer(PlaybackMode.REALTIME, lambda seq: seq / 10, 20, clock)
    realtime.wait_until_due(0, 1.0)
    assert realtime.wait_until_due(1, 1.0) == 1
    assert host.now_s >= 5000.1


def test_a_late_frame_delays_the_next_ones() -> None:
    host = FakeHost()
    pacer, delivered_s = DelayingPacer(host.clock), []
    for stamp_s, rendering_s in ((7.0, 0.0), (7.1, 0.0), (7.2, 1.0), (7.3, 0.0), (7.4, 0.0)):
        host.sleep(rendering_s)
        host.sleep(pacer.seconds_until_due(stamp_s))
        delivered_s.append(host.now_s - 5000.0)
    assert delivered_s == pytest.approx([0.0, 0.1, 1.1, 1.2, 1.3])

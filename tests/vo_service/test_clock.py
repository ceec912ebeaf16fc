"""Published stamps: the clock they are on, and that they only rise."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera import Clock
from drivers.clock_jumps import MAX_STALE_FRAMES
from tests.vo_service.fakes import FakeClock
from vo_service.frame_source import (
    LiveClock,
    RecordedClock,
    TimestampFilter,
    make_publish_clock,
)

UNIX_S = 1_700_000_000.0


class WallClock:
    """A wall clock that somebody may set: `ahead_s` before the monotonic one."""

    def __init__(self, monotonic: FakeClock) -> None:
        self.ahead_s = UNIX_S
        self._monotonic = monotonic

    def __call__(self) -> float:
        return self._monotonic.now_s + self.ahead_s


@pytest.fixture
def monotonic() -> FakeClock:
    return FakeClock(5.0)


@pytest.fixture
def wall(monotonic: FakeClock) -> WallClock:
    return WallClock(monotonic)


@pytest.fixture
def clock(monotonic: FakeClock, wall: WallClock) -> LiveClock:
    return LiveClock(0.0, monotonic, wall)


def test_a_live_stamp_is_published_as_unix_time(clock: LiveClock) -> None:
    assert clock.published_s(7.25) == UNIX_S + 7.25


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 0.06, -0.06])
def test_a_clock_step_is_detected_once_and_the_offset_updated(
    clock: LiveClock, wall: WallClock, step_s: float
) -> None:
    wall.ahead_s += step_s
    assert [clock.has_stepped() for _ in range(3)] == [True, False, False]
    assert clock.published_s(7.25) == UNIX_S + step_s + 7.25


@pytest.mark.parametrize("slew_s", [0.049, -0.049])
def test_a_small_correction_of_the_wall_clock_does_not_change_stamps(
    clock: LiveClock, wall: WallClock, slew_s: float
) -> None:
    wall.ahead_s += slew_s
    assert not clock.has_stepped()
    assert clock.published_s(7.25) == UNIX_S + 7.25


def test_passing_time_is_no_step(clock: LiveClock, monotonic: FakeClock) -> None:
    monotonic.now_s += 86_400.0
    assert not clock.has_stepped()


def test_a_process_paused_between_two_readings_detects_no_step(monotonic: FakeClock) -> None:
    pauses = iter([0.0, 0.0, 0.0, 0.3, 0.0, 0.0])

    def realtime_s() -> float:
        now_s = monotonic.now_s + UNIX_S
        monotonic.now_s += next(pauses)
        return now_s

    assert not LiveClock(0.0, monotonic, realtime_s).has_stepped()


def test_the_known_bias_is_added_for_both_clocks(monotonic: FakeClock, wall: WallClock) -> None:
    assert LiveClock(-0.5, monotonic, wall).published_s(1.0) == UNIX_S + 0.5
    assert RecordedClock(-0.5).published_s(1.0) == 0.5


def test_a_recording_keeps_its_stamps_and_has_no_steps() -> None:
    clock = make_publish_clock(Clock.RECORDED, 0.0)
    assert clock.published_s(1305031102.175304) == 1305031102.175304
    assert not clock.has_stepped()


def test_a_camera_on_the_host_clock_gets_the_live_clock() -> None:
    assert isinstance(make_publish_clock(Clock.MONOTONIC, 0.0), LiveClock)


def test_repeated_and_backward_stamps_are_skipped() -> None:
    guard = TimestampFilter()
    assert [guard.check(stamp_s).is_accepted for stamp_s in (1.0, 1.0, 0.5, 2.0)] == [
        True,
        False,
        False,
        True,
    ]


def test_a_camera_with_a_new_clock_is_accepted_after_15_frames() -> None:
    guard = TimestampFilter()
    guard.check(1000.0)
    verdicts = [guard.check(k / 30) for k in range(MAX_STALE_FRAMES + 1)]
    assert [v.is_accepted for v in verdicts] == [False] * 14 + [True, True]
    assert [v.is_restart for v in verdicts] == [False] * 14 + [True, False]


def test_a_glitch_does_not_count_for_a_new_clock() -> None:
    guard = TimestampFilter()
    for k in range(100):
        assert guard.check(1000.0 + k).is_accepted
        assert not guard.check(1.0).is_accepted


@given(st.lists(st.floats(-1e3, 1e3) | st.sampled_from([0.0, 1.0, 2.0]), max_size=60))
def test_accepted_stamps_increase_except_after_a_restart_of_the_clock(
    stamps_s: list[float],
) -> None:
    guard = TimestampFilter()
    last_s = -math.inf
    for stamp_s in stamps_s:
        verdict = guard.check(stamp_s)
        if verdict.is_accepted:
            assert stamp_s > last_s or verdict.is_restart
            last_s = stamp_s
        assert verdict.is_accepted or not verdict.is_restart

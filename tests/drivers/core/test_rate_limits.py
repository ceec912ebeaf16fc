"""So many a second, with room for a burst."""

from collections.abc import Sequence
from itertools import accumulate

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.rate_limits import Throttle, TokenBucket


def test_a_burst_passes_and_then_the_rate_limit_applies() -> None:
    now_s = [0.0]
    bucket = TokenBucket(10.0, lambda: now_s[0])
    assert [bucket.try_acquire() for _ in range(12)] == [True] * 10 + [False] * 2
    now_s[0] = 0.1
    assert (bucket.try_acquire(), bucket.try_acquire()) == (True, False)


def test_the_waiting_time_is_reported() -> None:
    now_s = [0.0]
    bucket = TokenBucket(0.5, lambda: now_s[0])
    assert bucket.seconds_until_next() == 0.0
    assert bucket.try_acquire()
    assert bucket.seconds_until_next() == 2.0
    now_s[0] = 1.5
    assert bucket.seconds_until_next() == 0.5


@given(st.floats(0.1, 1000.0), st.lists(st.floats(0.0, 2.0), max_size=60))
def test_the_rate_and_one_burst_are_never_exceeded(per_second: float, waits_s: list[float]) -> None:
    now_s = [0.0]
    bucket = TokenBucket(per_second, lambda: now_s[0])
    taken = 0
    for wait_s in waits_s:
        now_s[0] += wait_s
        taken += bucket.try_acquire()
    assert taken <= now_s[0] * per_second + max(1.0, per_second) + 1e-6


def count_allowed(throttle: Throttle, times_s: Sequence[float]) -> int:
    return sum(throttle.allow(time_s) for time_s in times_s)


@pytest.mark.parametrize(("max_hz", "expected"), [(30.0, 300), (20.0, 200), (10.0, 100), (1.0, 10)])
def test_a_camera_of_30_hz_is_thinned_to_the_rate(max_hz: float, expected: int) -> None:
    stamps_s = [k / 30.0 for k in range(300)]
    assert count_allowed(Throttle(1.0 / max_hz), stamps_s) == pytest.approx(expected, abs=1)


@given(st.lists(st.floats(-0.004, 0.004), min_size=20, max_size=60))
def test_jitter_loses_no_event(jitters_s: list[float]) -> None:
    stamps_s = [k / 30.0 + jitter_s for k, jitter_s in enumerate(jitters_s)]
    assert count_allowed(Throttle(1.0 / 30.0), stamps_s) == len(stamps_s)


@given(st.lists(st.floats(0.0, 3.0), max_size=60))
def test_the_rate_is_never_exceeded_by_more_than_one(waits_s: list[float]) -> None:
    times_s = list(accumulate(waits_s))
    allowed = count_allowed(Throttle(1.0), times_s)
    assert allowed <= (times_s[-1] - times_s[0] if times_s else 0.0) + 2.0


def test_a_clock_that_is_set_back_does_not_block() -> None:
    throttle = Throttle(1.0)
    assert [throttle.allow(time_s) for time_s in (100.0, 100.1, 50.0, 50.1, 51.0)] == [
        *(True, False),
        *(True, False, True),
    ]

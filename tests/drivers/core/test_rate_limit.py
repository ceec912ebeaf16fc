"""So many a second, with room for a burst."""

from hypothesis import given
from hypothesis import strategies as st

from drivers.core.rate_limit import TokenBucket


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

import random
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.time_sync import HostClockSync, StampUnwrapper

TICKS = 60_000_000
WRAP = 1 << 32
PERIOD_S = 1 / 30
READOUT_S = 0.020

steps = st.lists(st.integers(0, 2**31 - 1), min_size=1, max_size=60)


@given(st.integers(0, WRAP - 1), steps)
def test_ticks_are_exact_through_any_number_of_wraps(first: int, increments: list[int]) -> None:
    clock, ticks = StampUnwrapper(TICKS, 32), first
    assert clock.unwrap_s(first) == first / TICKS
    for increment in increments:
        ticks += increment
        assert clock.unwrap_s(ticks % WRAP) == ticks / TICKS


@given(st.integers(0, 300), st.integers(-TICKS // 10, TICKS // 10), st.booleans())
def test_two_streams_agree_out_of_order_around_a_wrap(
    before: int, apart: int, depth_first: bool
) -> None:
    clock = StampUnwrapper(TICKS, 32)
    color = [WRAP + (k - before) * TICKS // 30 for k in range(600)]
    seconds = {}
    for k, ticks in enumerate(color):
        pair = [("color", ticks), ("depth", ticks + apart)]
        for name, value in reversed(pair) if depth_first ^ (k % 7 == 3) else pair:
            seconds[name] = clock.unwrap_s(value % WRAP)
        assert seconds["depth"] - seconds["color"] == pytest.approx(apart / TICKS, abs=1e-9)


def test_a_counter_in_microseconds_that_never_wraps_passes_unchanged() -> None:
    clock = StampUnwrapper(1e6, 64)
    assert [clock.unwrap_s(us) for us in (0, 33_333, 10**12)] == [0.0, 0.033333, 1e6]


def arrivals(count: int, ppm: float, seed: int, late_s: float = 0.03) -> list[tuple[float, float]]:
    """(device seconds, arrival) of a stream that the host sees late by chance; device 0 is 500."""
    rng = random.Random(seed)
    stamps_s = [k * PERIOD_S for k in range(count)]
    return [
        (s, 500 + s * (1 + ppm * 1e-6) + READOUT_S + rng.random() ** 3 * late_s) for s in stamps_s
    ]


@pytest.mark.parametrize("ppm", [-100.0, 0.0, 100.0])
def test_stamps_follow_the_true_times_despite_clock_drift(ppm: float) -> None:
    host = HostClockSync(READOUT_S)
    for device_s, receive_time_s in arrivals(30 * 300, ppm, seed=1):
        error_s = host.to_host_s(device_s, receive_time_s) - (500 + device_s * (1 + ppm * 1e-6))
        assert device_s < 2.0 or abs(error_s) < 0.004


@given(st.lists(st.tuples(st.floats(0.001, 2.0), st.floats(0.0, 0.5)), max_size=80))
def test_stamps_always_increase_even_for_late_frames(steps: list[tuple[float, float]]) -> None:
    host, device_s, stamps_s = HostClockSync(READOUT_S), 0.0, []
    for step_s, late_s in steps:
        device_s += step_s
        stamps_s.append(host.to_host_s(device_s, 500 + device_s + READOUT_S + late_s))
    assert all(a < b for a, b in pairwise(stamps_s))


@given(st.lists(st.tuples(st.floats(0.001, 2.0), st.floats(0.0, 0.5)), max_size=80))
def test_a_stamp_is_never_earlier_than_its_frame(steps: list[tuple[float, float]]) -> None:
    host, device_s = HostClockSync(READOUT_S), 0.0
    for step_s, late_s in steps:
        device_s += step_s
        stamp_s = host.to_host_s(device_s, 500 + device_s + READOUT_S + late_s)
        assert stamp_s >= 500 + device_s - 1e-6


def test_a_late_first_frame_is_corrected_without_going_back() -> None:
    host = HostClockSync(0.0)
    assert host.to_host_s(0.0, 500.2) == pytest.approx(500.2)
    stamps_s = [host.to_host_s(k * PERIOD_S, 500 + k * PERIOD_S) for k in range(1, 20)]
    assert stamps_s[0] == pytest.approx(500.2 + PERIOD_S / 2)
    assert stamps_s[-1] == pytest.approx(500 + 19 * PERIOD_S, abs=1e-4)


@pytest.mark.parametrize("device_jump_s", [0.0, -400.0, 1000.0])
def test_after_a_long_gap_the_clocks_are_compared_again(device_jump_s: float) -> None:
    host = HostClockSync(READOUT_S)
    host.to_host_s(1000.0, 500.0)
    assert host.to_host_s(1000.0 + device_jump_s + 60.0, 567.0) == pytest.approx(567.0 - READOUT_S)

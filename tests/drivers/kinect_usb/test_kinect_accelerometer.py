"""The accelerometer's readings as one gravity."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Vector
from drivers.kinect_usb.motor_unit import GravityFilter, gravity_from_counts

LEVEL: Vector = (0.0, 9.80665, 0.0)
TILTED: Vector = (0.0, 8.5, 4.9)


@pytest.fixture
def meter() -> GravityFilter:
    return GravityFilter()


def test_a_level_kinect_gives_gravity_straight_down_and_three_zeros_give_none() -> None:
    assert gravity_from_counts(0, 819, 0) == pytest.approx(LEVEL)
    assert gravity_from_counts(0, 0, 0) is None


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=20))
def test_gravity_is_the_mean_of_the_last_second(across: list[float]) -> None:
    meter = GravityFilter()
    meter.add(TILTED, 8.0, is_moving=False)  # longer ago
    for number, x in enumerate(across):
        assert meter.add((x, 9.8, 0.0), 9.5 + 0.01 * number, is_moving=False)
    found = meter.mean_at(9.9)
    assert found == pytest.approx((sum(across) / len(across), 9.8, 0.0))


def test_readings_older_than_a_second_or_than_a_reset_are_ignored(meter: GravityFilter) -> None:
    assert meter.mean_at(1.0) is None
    meter.add(LEVEL, 5.0, is_moving=False)
    assert meter.mean_at(5.9) == LEVEL
    assert meter.mean_at(6.1) is None
    meter.reset()
    assert meter.mean_at(5.1) is None


@pytest.mark.parametrize("reading", [None, (0.0, 12.0, 0.0), (0.0, 8.0, 0.0)])
def test_a_push_or_missing_data_does_not_change_gravity(
    meter: GravityFilter, reading: Vector | None
) -> None:
    meter.add(LEVEL, 5.0, is_moving=False)
    assert not meter.add(reading, 5.1, is_moving=False)
    assert meter.mean_at(5.2) == LEVEL


def test_while_the_head_moves_only_the_newest_reading_counts(meter: GravityFilter) -> None:
    meter.add(LEVEL, 5.0, is_moving=False)
    meter.add(TILTED, 5.1, is_moving=True)
    assert meter.mean_at(5.2) == TILTED


def test_after_a_tilt_request_only_newer_readings_count(meter: GravityFilter) -> None:
    meter.ignore_until(until_s=6.0)
    for now_s, reading in ((5.0, LEVEL), (5.1, TILTED)):
        meter.add(reading, now_s, is_moving=False)
    assert meter.mean_at(5.2) == TILTED

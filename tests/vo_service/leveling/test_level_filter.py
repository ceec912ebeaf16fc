"""The complementary filter of the up direction."""

from math import degrees, hypot, radians

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import STANDARD_GRAVITY_M_S2, Array, so3_exp
from vo_service.leveling.level_filter import MAX_RATE_RAD_S, LevelFilter
from vo_service.types.level import LevelSource

STEP_S = 1.0 / 30.0
UP = np.array([0.0, 0.0, STANDARD_GRAVITY_M_S2])


def turns(
    level_filter: LevelFilter, R: Array, seconds: float, start_s: float = 0.0
) -> list[tuple[Array, Array]]:
    """Correct an `odom` whose up is R z, by its floor; return each turn and attitude."""
    made = []
    for n in range(round(seconds / STEP_S)):
        level_filter.add_floor(R[:, 2], 0.0, start_s + n * STEP_S)
        turn_rad = level_filter.step(start_s + n * STEP_S).turn_rad
        R = so3_exp(turn_rad) @ R
        made.append((turn_rad, R))
    return made


@given(st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0)))
def test_the_floor_levels_odom_slowly_and_about_horizontal_axes(
    rotation_rad: tuple[float, float, float],
) -> None:
    for turn_rad, _ in turns(LevelFilter(), so3_exp(rotation_rad), 3.0):
        assert hypot(*turn_rad) <= MAX_RATE_RAD_S * STEP_S + 1e-12
        assert turn_rad[2] == 0.0


def test_a_tilt_of_a_degree_is_gone_after_ten_seconds() -> None:
    _, R = turns(LevelFilter(), so3_exp([radians(1.0), 0.0, 0.5]), 10.0)[-1]
    assert degrees(np.arccos(R[2, 2])) < 0.02


def test_a_jump_of_the_floor_moves_odom_by_less_than_a_millimeter_a_frame() -> None:
    level_filter, height_m = LevelFilter(), 0.0
    for n in range(100):
        level_filter.add_floor(np.array([0.0, 0.0, 1.0]), 0.5 - height_m, n * STEP_S)
        shift_m = level_filter.step(n * STEP_S).shift_m
        assert 0.0 <= shift_m < 1e-3
        height_m += shift_m
    assert height_m > 0.05


def test_a_gap_between_frames_is_not_made_up_for_at_once() -> None:
    level_filter = LevelFilter()
    level_filter.add_floor(so3_exp([0.2, 0.0, 0.0])[:, 2], 0.0, 0.0)
    level_filter.step(0.0)
    assert hypot(*level_filter.step(20.0).turn_rad) < radians(0.03)


def test_the_bias_is_learned_with_the_floor_and_then_removed() -> None:
    bias_m_s2 = np.array([0.2, -0.1, 0.05])
    level_filter = LevelFilter()
    level_filter.start(LevelSource.FLOOR)
    for n in range(30 * 30):
        level_filter.add_floor(np.array([0.0, 0.0, 1.0]), 0.0, n * STEP_S)
        level_filter.add_reading(np.eye(3), UP + bias_m_s2, n * STEP_S)
    assert level_filter.has_bias
    np.testing.assert_allclose(level_filter.bias_m_s2, bias_m_s2, atol=1e-6)
    level_filter.add_reading(np.eye(3), UP + bias_m_s2, 100.0)
    np.testing.assert_allclose(level_filter.step(100.0).turn_rad, 0.0, atol=1e-8)


@pytest.mark.parametrize("motion_m_s2", [4.0, np.nan, np.inf])
def test_a_reading_with_a_motion_in_it_is_left_out(motion_m_s2: float) -> None:
    level_filter = LevelFilter()
    level_filter.start(LevelSource.ACCELEROMETER)
    level_filter.add_reading(np.eye(3), UP + np.array([motion_m_s2, 0.0, 0.0]), 0.0)
    level_filter.step(0.0)
    np.testing.assert_array_equal(level_filter.step(0.03).turn_rad, 0.0)


def test_sigma_grows_without_a_floor_and_shrinks_with_one() -> None:
    level_filter = LevelFilter()
    turns(level_filter, np.eye(3), 20.0)
    with_floor = level_filter.sigma_rad
    for n in range(600):
        level_filter.add_reading(np.eye(3), UP, 30.0 + n * STEP_S)
        level_filter.step(30.0 + n * STEP_S)
    without_floor = level_filter.sigma_rad
    turns(level_filter, np.eye(3), 20.0, start_s=60.0)
    assert without_floor > 2.0 * with_floor > 0.0
    assert level_filter.sigma_rad < 0.5 * without_floor


def test_an_assumed_level_is_left_as_it_is() -> None:
    level_filter = LevelFilter()
    level_filter.start(LevelSource.ASSUMED)
    level_filter.step(0.0)
    np.testing.assert_array_equal(level_filter.step(0.03).turn_rad, 0.0)
    assert level_filter.sigma_rad == 0.0

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.geometry import Array, adjoint, inverse
from tests.vo_service.odometry.keyframe.rolling_views import BRISK, series_exponential
from vo_service.odometry.keyframe.descent import body_velocity, solve, tie_velocity

FEW = settings(max_examples=30)
TWISTS = arrays(np.float64, 6, elements=st.floats(-1.0, 1.0, allow_subnormal=False))


@FEW
@given(st.integers(0, 2**32 - 1), st.sampled_from([6, 12]))
def test_a_positive_system_is_solved(seed: int, size: int) -> None:
    random = np.random.default_rng(seed)
    A = random.normal(size=(size, 2 * size))
    A, b = A @ A.T, random.normal(size=size)
    np.testing.assert_allclose(solve(A, b), np.linalg.solve(A, b), rtol=1e-6, atol=1e-9)


def test_a_system_that_says_nothing_has_an_answer() -> None:
    assert np.all(np.isfinite(solve(np.zeros((6, 6)), np.zeros(6))))


@FEW
@given(TWISTS, TWISTS)
def test_the_cameras_velocity_is_minus_that_of_the_motion_in_its_own_axes(
    twist: Array, velocity: Array
) -> None:
    T_camera_keyframe = series_exponential(twist)
    own = body_velocity(T_camera_keyframe, velocity)
    np.testing.assert_allclose(own, -adjoint(T_camera_keyframe) @ velocity, atol=1e-12)


def test_the_velocity_is_that_of_the_camera_that_moves() -> None:
    """T_camera_keyframe(t) = T exp(t velocity): its own twist is a difference in time."""
    T, velocity, step_s = inverse(BRISK.at(0.7)), np.array([0.1, 0.3, -0.2, 0.4, -0.1, 0.2]), 1e-6
    later = T @ series_exponential(step_s * velocity)
    rate = (T @ inverse(later) - np.eye(4)) / step_s
    own = body_velocity(T, velocity)
    np.testing.assert_allclose(rate[:3, 3], own[:3], atol=1e-5)
    np.testing.assert_allclose([rate[2, 1], rate[0, 2], rate[1, 0]], own[3:], atol=1e-5)


@FEW
@given(TWISTS, st.floats(1.0, 60.0), st.integers(0, 1000))
def test_the_tie_is_the_square_of_how_far_velocity_and_way_are_apart(
    off: Array, rate_hz: float, seed: int
) -> None:
    """Its value is sum P (off + e - rate d)^2 for a step d of the motion and e of the velocity."""
    random = np.random.default_rng(seed)
    information, step = random.uniform(1.0, 100.0, 6), random.normal(size=12)
    H, g = np.zeros((12, 12)), np.zeros(12)
    tie_velocity(H, g, off, rate_hz, information)
    value = step @ H @ step + 2 * g @ step + information @ off**2
    apart = off + step[6:] - rate_hz * step[:6]
    assert value == pytest.approx(information @ apart**2, rel=1e-6)
    np.testing.assert_array_equal(H, H.T)

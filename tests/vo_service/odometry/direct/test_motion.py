"""Rigid motions, and the motion of a camera during a rolling shutter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from drivers.core.geometry import (
    Array,
    adjoint,
    inverse,
    is_rigid,
    orthonormalize,
    rigid_transform,
    transform_points,
)
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    SHAKING,
    MovingCamera,
    series_exponential,
)
from vo_service.odometry.direct.motion import (
    body_motion,
    change_frame,
    compose,
    constant_velocity_motion,
    fit_through_poses,
    invert,
    orthonormalize_rotation,
    propagate_motion,
    propagate_point,
    se3_adjoint,
    se3_exp,
    se3_log,
    transform_point,
)

FEW = settings(max_examples=30)

NUMBERS = st.floats(-3.0, 3.0, allow_subnormal=False)

VECTORS = arrays(np.float64, 3, elements=NUMBERS)

DIRECTIONS = VECTORS.filter(lambda v: np.linalg.norm(v) > 1e-3)

# From nothing over where the series take over up to nearly half a turn.
ANGLES_RAD = st.one_of(
    st.just(0.0),
    st.floats(1e-12, 1e-2),
    st.floats(9.9e-4, 1.01e-3),
    st.floats(1e-2, np.pi - 1e-4),
)


@st.composite
def twists(draw: st.DrawFn) -> Array:
    axis = draw(DIRECTIONS)
    return np.concatenate([draw(VECTORS), draw(ANGLES_RAD) * axis / np.linalg.norm(axis)])


@FEW
@given(twists())
def test_the_exponential_is_the_matrix_exponential(twist: Array) -> None:
    T = se3_exp(twist)
    assert is_rigid(T)
    np.testing.assert_allclose(T, series_exponential(twist), atol=1e-12)


@FEW
@given(twists())
def test_the_logarithm_inverts_the_exponential(twist: Array) -> None:
    # Near half a turn the axis is known from a difference that vanishes.
    left_rad = np.pi - float(np.linalg.norm(twist[3:]))
    np.testing.assert_allclose(se3_log(se3_exp(twist)), twist, atol=1e-9 / left_rad)


@FEW
@given(VECTORS)
def test_a_twist_without_rotation_is_a_translation(translation_m: Array) -> None:
    T = rigid_transform(np.eye(3), translation_m)
    np.testing.assert_array_equal(se3_exp(np.concatenate([translation_m, np.zeros(3)])), T)
    np.testing.assert_array_equal(se3_log(T), np.concatenate([translation_m, np.zeros(3)]))


@pytest.mark.parametrize("angle_rad", [np.pi - 1e-6, np.pi - 1e-9])
def test_a_rotation_near_half_a_turn_is_exact(angle_rad: float) -> None:
    twist = np.array([0.3, -0.2, 0.5, 0.6 * angle_rad, 0.0, 0.8 * angle_rad])
    np.testing.assert_allclose(se3_exp(se3_log(se3_exp(twist))), se3_exp(twist), atol=1e-6)


@FEW
@given(twists(), twists())
def test_the_product_is_the_matrix_product(a: Array, b: Array) -> None:
    A, B = se3_exp(a), se3_exp(b)
    np.testing.assert_allclose(compose(A, B), A @ B, atol=1e-13)


@FEW
@given(twists(), VECTORS)
def test_a_point_is_transformed_as_by_the_matrix(twist: Array, point: Array) -> None:
    T = se3_exp(twist)
    expected = T[:3, :3] @ point + T[:3, 3]
    np.testing.assert_allclose(transform_point(T, *point), expected, atol=1e-12)


@FEW
@given(twists(), st.floats(-1e-3, 1e-3))
def test_the_kernels_are_those_of_the_geometry_of_all_methods(twist: Array, error: float) -> None:
    T = se3_exp(twist)
    np.testing.assert_allclose(invert(T), inverse(T), atol=1e-12)
    np.testing.assert_allclose(se3_adjoint(T), adjoint(T), atol=1e-12)
    T[0, 1] += error
    np.testing.assert_allclose(orthonormalize_rotation(T), orthonormalize(T), atol=1e-12)


UP_TO_ONE = st.floats(-1.0, 1.0, allow_subnormal=False)
TWISTS, MOTIONS = (arrays(np.float64, n, elements=UP_TO_ONE) for n in (6, 9))

X, Y, Z = POINT = np.array([0.4, -0.3, 1.7])


@FEW
@given(TWISTS, TWISTS)
def test_the_camera_velocity_is_the_negative_of_the_motion_in_its_axes(
    twist: Array, velocity: Array
) -> None:
    T_camera_keyframe = series_exponential(twist)
    own = body_motion(T_camera_keyframe, constant_velocity_motion(velocity))
    expected = constant_velocity_motion(-adjoint(T_camera_keyframe) @ velocity)
    np.testing.assert_allclose(own, expected, atol=1e-12)


@FEW
@given(TWISTS, MOTIONS)
def test_a_motion_changes_frame_and_back_unchanged(twist: Array, motion_9: Array) -> None:
    T = series_exponential(twist)
    there = change_frame(motion_9, inverse(T))
    np.testing.assert_allclose(body_motion(T, -there), motion_9, atol=1e-12)
    acceleration = change_frame(motion_9, T)[6:]
    assert np.linalg.norm(acceleration) == pytest.approx(np.linalg.norm(motion_9[6:]))


def test_the_velocity_is_that_of_the_moving_camera() -> None:
    """T_camera_keyframe(t) = T exp(t velocity): its own twist is a difference in time."""
    T, velocity, step_s = (
        inverse(BRISK.pose_at(0.7)),
        np.array([0.1, 0.3, -0.2, 0.4, -0.1, 0.2]),
        1e-6,
    )
    after = T @ series_exponential(step_s * velocity)
    rate = (T @ inverse(after) - np.eye(4)) / step_s
    own = body_motion(T, constant_velocity_motion(velocity))
    np.testing.assert_allclose(rate[:3, 3], own[:3], atol=1e-5)
    np.testing.assert_allclose([rate[2, 1], rate[0, 2], rate[1, 0]], own[3:6], atol=1e-5)


@pytest.mark.parametrize("delay_s", [-0.012, -0.005, 0.006, 0.012])
def test_a_point_is_warped_by_an_accelerated_motion(delay_s: float) -> None:
    (exact,) = transform_points(inverse(SHAKING.pose_at(delay_s)), POINT[None])
    there = propagate_point(SHAKING.motion, X, Y, Z, delay_s)
    without = propagate_point(constant_velocity_motion(SHAKING.velocity), X, Y, Z, delay_s)
    np.testing.assert_allclose(there, exact, atol=1.5e-5)
    assert np.linalg.norm(without - exact) > 20 * np.linalg.norm(there - exact)


@pytest.mark.parametrize("early_s", [-0.012, 0.012])
def test_a_later_row_is_transformed_back(early_s: float) -> None:
    ((x, y, z),) = transform_points(inverse(SHAKING.pose_at(early_s)), POINT[None])
    back = propagate_point(propagate_motion(SHAKING.motion, early_s), x, y, z, -early_s)
    np.testing.assert_allclose(back, POINT, atol=3e-5)
    wrong = propagate_point(SHAKING.motion, x, y, z, -early_s)
    assert np.linalg.norm(wrong - POINT) > 1e-3


@FEW
@given(TWISTS, TWISTS)
def test_three_poses_with_a_constant_twist_give_it(start: Array, velocity: Array) -> None:
    stamps_s = (10.0, 10.03, 10.07)
    T = series_exponential(start)
    before, now, after = (T @ series_exponential(t * velocity) for t in stamps_s)
    fitted = fit_through_poses((before, now, after), stamps_s)
    np.testing.assert_allclose(fitted, constant_velocity_motion(velocity), atol=1e-9)


@pytest.mark.parametrize("until_s", [0.03, 0.05])
def test_three_poses_with_an_angular_acceleration_give_it(until_s: float) -> None:
    turning = np.array([0.3, -0.4, 0.5])
    hand = MovingCamera(np.concatenate([np.zeros(3), turning]), acceleration_rad_s2=20.0 * turning)
    stamps_s = (-0.03, 0.0, until_s)
    before, now, after = (hand.pose_at(t) for t in stamps_s)
    np.testing.assert_allclose(
        fit_through_poses((before, now, after), stamps_s), hand.motion, atol=1e-9
    )

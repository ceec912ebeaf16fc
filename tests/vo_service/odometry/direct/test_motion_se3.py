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
)
from tests.vo_service.odometry.direct.rolling_shutter_views import series_exponential
from vo_service.odometry.direct.motion import (
    compose,
    invert,
    orthonormalize_rotation,
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

"""Rotations and rigid transforms against scipy's, which knows nothing of this project."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from drivers.core.geometry import (
    Array,
    adjoint,
    inverse,
    is_rigid,
    orthonormalize,
    pose_distance,
    poses_close,
    quaternion_from_rotation,
    rigid_transform,
    rotation_angle_rad,
    rotation_from_quaternion,
    skew_matrix,
    so3_exp,
    transform_from_pose,
    transform_points,
)

vectors = arrays(np.float64, 3, elements=st.floats(-10.0, 10.0))
unit_quaternions = (
    arrays(np.float64, 4, elements=st.floats(-1.0, 1.0))
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: q / np.linalg.norm(q))
)
transforms = st.builds(transform_from_pose, vectors, unit_quaternions)

# Rotations of a half turn, where w is 0 and formulas that divide by it fail.
HALF_TURNS = [[1.0, 0, 0, 0], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0.6, 0, 0.8, 0]]


def twist_step(T: Array, twist: Array) -> Array:
    """A small motion by a twist (translation, rotation) in the frame that T maps to."""
    return rigid_transform(so3_exp(twist[3:]), twist[:3]) @ T


@given(unit_quaternions)
def test_a_quaternion_gives_the_rotation_of_scipy(q: Array) -> None:
    assert np.allclose(rotation_from_quaternion(q), Rotation.from_quat(q).as_matrix(), atol=1e-14)


@given(unit_quaternions)
def test_quaternion_to_matrix_and_back_is_exact(q: Array) -> None:
    back = quaternion_from_rotation(rotation_from_quaternion(q))
    assert back[3] >= 0
    assert np.allclose(back, q, atol=1e-12) or np.allclose(back, -q, atol=1e-12)


@pytest.mark.parametrize("q", HALF_TURNS)
def test_half_turns_to_quaternion_and_back_are_exact(q: list[float]) -> None:
    R = rotation_from_quaternion(q)
    assert np.allclose(rotation_from_quaternion(quaternion_from_rotation(R)), R, atol=1e-12)


@pytest.mark.parametrize("length", [1e-320, 1e-200, 0.5, 1e200])
def test_a_quaternion_may_have_any_length(length: float) -> None:
    assert np.allclose(rotation_from_quaternion([0, 0, length, 0]), np.diag([-1, -1, 1]))


@pytest.mark.parametrize("q", [[0, 0, 0, 0], [0, np.nan, 0, 1], [np.inf, 0, 0, 1]])
def test_an_invalid_quaternion_is_rejected(q: list[float]) -> None:
    with pytest.raises(ValueError, match="not a rotation"):
        rotation_from_quaternion(q)


@given(vectors)
def test_rodrigues_formula_agrees_with_scipy(v: Array) -> None:
    assert np.allclose(so3_exp(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-13)


@given(st.floats(1e-12, np.pi))
def test_small_angles_are_exact(angle_rad: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    measured = rotation_angle_rad(so3_exp(axis * angle_rad))
    assert measured == pytest.approx(angle_rad, rel=1e-12, abs=1e-15)


def test_no_rotation_has_no_angle() -> None:
    assert rotation_angle_rad(np.eye(3)) == 0.0
    assert np.array_equal(so3_exp([0, 0, 0]), np.eye(3))


@given(vectors, vectors)
def test_a_skew_matrix_is_the_cross_product(v: Array, w: Array) -> None:
    assert np.allclose(skew_matrix(v) @ w, np.cross(v, w))


@given(transforms)
def test_a_transform_and_its_inverse_cancel(T: Array) -> None:
    assert np.allclose(inverse(T) @ T, np.eye(4), atol=1e-12)
    assert is_rigid(inverse(T))


@given(transforms, transforms, vectors)
def test_transforms_compose_as_their_names_say(T_a_b: Array, T_b_c: Array, p: Array) -> None:
    p_c = p[None]
    one_by_one = transform_points(T_a_b, transform_points(T_b_c, p_c))
    assert np.allclose(transform_points(T_a_b @ T_b_c, p_c), one_by_one, atol=1e-10)


def test_pose_distance_does_not_depend_on_the_reference_frame() -> None:
    step = rigid_transform(so3_exp([0.0, 0.2, 0.0]), [0.3, 0.0, 0.4])
    here = rigid_transform(so3_exp([1.0, 0.5, -0.3]), [5.0, -2.0, 7.0])
    np.testing.assert_allclose(pose_distance(here, here @ step), (0.5, 0.2))
    assert poses_close(here, here @ step, 0.51, 0.21)
    assert not poses_close(here, here @ step, 0.49, 0.21)
    assert not poses_close(here, here @ step, 0.51, 0.19)


def test_points_are_rows_that_are_rotated_then_translated() -> None:
    quarter_turn_about_z = so3_exp([0, 0, np.pi / 2])
    T = rigid_transform(quarter_turn_about_z, [10, 20, 30])
    moved = transform_points(T, np.array([[1.0, 0, 0], [0, 2.0, 0], [0, 0, 3.0]]))
    assert np.allclose(moved, [[10, 21, 30], [8, 20, 30], [10, 20, 33]])


def test_orthonormalize_removes_rounding_errors() -> None:
    T = rigid_transform(so3_exp([0.4, -0.2, 0.1]), [1.0, 2.0, 3.0])
    rounded = T.copy()
    rounded[:3, :3] += 1e-6 * np.arange(9.0).reshape(3, 3)
    cleaned = orthonormalize(rounded)
    assert is_rigid(cleaned, tolerance=1e-14)
    np.testing.assert_allclose(cleaned, T, atol=1e-5)


@given(transforms, arrays(np.float64, 6, elements=st.floats(-1.0, 1.0)))
def test_the_adjoint_transforms_a_small_motion_to_another_frame(T: Array, twist: Array) -> None:
    small = 1e-7 * twist
    in_the_other_frame = twist_step(np.eye(4), adjoint(T) @ small) @ T
    assert np.allclose(in_the_other_frame, T @ twist_step(np.eye(4), small), atol=1e-11)


@pytest.mark.parametrize(
    "T",
    [
        np.eye(3),
        np.diag([1.0, 1.0, -1.0, 1.0]),  # a mirror
        np.diag([1.00001, 1.0, 1.0, 1.0]),  # a stretch
        np.diag([1.0, 1.0, 1.0, 2.0]),
        np.eye(4) + np.eye(4, k=-3),  # a last row that is none
        np.full((4, 4), 1e200),
        np.full((4, 4), np.nan),
    ],
)
def test_a_transform_that_is_not_rigid_is_rejected(T: Array) -> None:
    assert not is_rigid(T)

"""Motion up to scale by rays only."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, rigid_transform, rotation_angle_rad, so3_exp
from drivers.core.geometry import so3_exp as turn_by
from tests.vo_service.odometry.sfm.ray_pairs import (
    MOTION,
    SIGMA,
    make_cloud,
    make_pairs,
    small_vectors,
)
from vo_service.odometry.sfm.essential import (
    find_essential,
    find_unscaled_motion,
    recover_unscaled_motion,
    triangulate,
)
from vo_service.odometry.sfm.mono_frame import RayPairs


def angle_deg(a: Array, b: Array) -> float:
    return float(
        np.degrees(np.arccos(np.clip(a @ b / np.linalg.norm(a) / np.linalg.norm(b), -1, 1)))
    )


@settings(max_examples=20)
@given(small_vectors(0.3), small_vectors(0.2))
def test_the_direction_of_any_motion_with_parallax_is_estimated(turn: Array, shift: Array) -> None:
    assume(np.linalg.norm(shift) > 0.05)
    T_reference_camera = rigid_transform(turn_by(turn), shift)
    T = inverse(T_reference_camera)
    direction = find_unscaled_motion(make_pairs(T_reference_camera), seed=1)
    assert direction is not None
    assert np.degrees(rotation_angle_rad(direction.R @ T[:3, :3].T)) < 0.1
    assert angle_deg(direction.t, T[:3, 3]) < 2.0
    assert np.linalg.norm(direction.t) == pytest.approx(1.0)


def test_wrong_pairs_are_outliers() -> None:
    pairs = make_pairs(MOTION, noise=0.3 * SIGMA)
    swapped = pairs.ray.copy()
    swapped[:50] = np.roll(swapped[:50], 1, axis=0)
    direction = find_unscaled_motion(replace(pairs, ray=swapped), seed=1)
    assert direction is not None
    assert direction.inlier[50:].mean() > 0.95
    assert direction.inlier[:50].mean() < 0.1
    assert angle_deg(direction.t, inverse(MOTION)[:3, 3]) < 3.0


def test_a_pure_rotation_is_estimated_without_a_direction() -> None:
    T_reference_camera = rigid_transform(turn_by([0.05, 0.1, -0.04]), np.zeros(3))
    direction = find_unscaled_motion(make_pairs(T_reference_camera, noise=0.2 * SIGMA), seed=1)
    assert direction is not None
    assert np.degrees(rotation_angle_rad(direction.R @ T_reference_camera[:3, :3])) < 0.3


def test_a_camera_at_rest_has_not_rotated() -> None:
    direction = find_unscaled_motion(make_pairs(np.eye(4)), seed=1)
    assert direction is None or np.degrees(rotation_angle_rad(direction.R)) < 0.1


def test_of_the_four_motions_the_one_with_points_in_front_is_chosen() -> None:
    pairs = make_pairs(MOTION)
    essential = find_essential(pairs, seed=1)
    assert essential is not None
    for sign in (1.0, -1.0):
        direction = recover_unscaled_motion(replace(essential, E=sign * essential.E), pairs)
        assert direction is not None
        assert angle_deg(direction.t, inverse(MOTION)[:3, 3]) < 1.0


@pytest.mark.parametrize("count", [0, 1, 7])
def test_too_few_pairs_give_no_motion(count: int) -> None:
    assert find_unscaled_motion(make_pairs(MOTION, count=count), seed=1) is None


def test_identical_pairs_are_no_error() -> None:
    one = np.tile([0.1, 0.2, 1.0], (20, 1))
    pairs = RayPairs(one, one, np.ones(20), np.zeros(20), SIGMA)
    direction = find_unscaled_motion(pairs, seed=1)
    assert direction is None or np.isfinite(direction.R).all()


@given(small_vectors(0.2), small_vectors(0.3), st.integers(0, 9))
def test_triangulated_depths_are_correct(turn: Array, shift: Array, n: int) -> None:
    T_reference_camera = rigid_transform(so3_exp(turn), shift + np.array([0.4, 0.0, 0.0]))
    T = inverse(T_reference_camera)
    found = triangulate(T[:3, :3], T[:3, 3], make_pairs(T_reference_camera, count=10))
    np.testing.assert_allclose(found.inverse_depth[n], 1.0 / make_cloud(10)[n, 2], rtol=1e-6)


def test_the_opposite_motion_puts_all_points_behind() -> None:
    T = inverse(MOTION)
    found = triangulate(T[:3, :3], -T[:3, 3], make_pairs(MOTION))
    assert (found.inverse_depth < 0.0).all()


def test_parallax_is_the_angle_at_the_point() -> None:
    sideways = rigid_transform(np.eye(3), [0.1, 0.0, 0.0])
    T = inverse(sideways)
    found = triangulate(T[:3, :3], T[:3, 3], make_pairs(sideways))
    np.testing.assert_allclose(found.parallax_rad, np.arctan(0.1 / make_cloud()[:, 2]), rtol=1e-6)


def test_without_any_motion_there_is_no_parallax() -> None:
    found = triangulate(np.eye(3), np.zeros(3), make_pairs(np.eye(4)))
    assert np.isfinite(found.inverse_depth).all()
    assert (found.parallax_rad == 0.0).all()

"""The length of a motion by points that are known."""

import numpy as np
import pytest

from drivers.geometry import inverse, rigid_transform, rotation_from_vector
from tests.vo_service.odometry.sfm.ray_views import MOTION, SIGMA, pairs_of
from vo_service.odometry.sfm.essential import Direction, find_direction
from vo_service.odometry.sfm.scale import motions_to_scale


def test_known_points_give_the_motion_its_length() -> None:
    pairs = pairs_of(MOTION, known_to=0.05, noise=0.3 * SIGMA)
    motions = motions_to_scale(find_direction(pairs, seed=1), pairs)
    assert len(motions) == 2
    for T_camera_reference in motions:
        length_m = np.linalg.norm(T_camera_reference[:3, 3])
        assert length_m == pytest.approx(np.linalg.norm(MOTION[:3, 3]), rel=0.05)


def test_a_turn_on_the_spot_has_no_length_though_the_direction_is_any() -> None:
    turn = rigid_transform(rotation_from_vector([0.02, 0.08, 0.0]), np.zeros(3))
    pairs = pairs_of(turn, known_to=0.05, noise=0.2 * SIGMA)
    found = find_direction(pairs, seed=1)
    assert found is not None
    right = Direction(inverse(turn)[:3, :3], found.t, np.ones(len(pairs), np.bool_))
    (T_camera_reference,) = motions_to_scale(right, pairs)
    assert np.linalg.norm(T_camera_reference[:3, 3]) < 0.002


def test_a_motion_much_shorter_than_any_parallax_is_still_measured() -> None:
    step = rigid_transform(np.eye(3), [0.004, 0.0, 0.0])
    pairs = pairs_of(step, known_to=0.05)
    still = Direction(np.eye(3), np.array([0.0, 1.0, 0.0]), np.ones(len(pairs), np.bool_))
    T_camera_reference = motions_to_scale(still, pairs)[-1]
    np.testing.assert_allclose(T_camera_reference[:3, 3], [-0.004, 0.0, 0.0], atol=2e-4)


def test_points_of_unknown_depth_carry_no_scale() -> None:
    pairs = pairs_of(MOTION)
    assert motions_to_scale(find_direction(pairs, seed=1), pairs) == []
    assert motions_to_scale(None, pairs_of(MOTION, known_to=0.05)) == []

"""Scale of a motion by known points."""

import numpy as np
import pytest

from drivers.core.geometry import inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.sfm.ray_pairs import MOTION, SIGMA, make_pairs
from vo_service.odometry.sfm.essential import UnscaledMotion, find_unscaled_motion
from vo_service.odometry.sfm.scale import propose_scaled_motions


def test_known_points_give_the_motion_its_length() -> None:
    pairs = make_pairs(MOTION, known_to=0.05, noise=0.3 * SIGMA)
    motions = propose_scaled_motions(find_unscaled_motion(pairs, seed=1), pairs)
    assert len(motions) == 2
    for T_camera_reference in motions:
        length_m = np.linalg.norm(T_camera_reference[:3, 3])
        assert length_m == pytest.approx(np.linalg.norm(MOTION[:3, 3]), rel=0.05)


def test_a_pure_rotation_has_length_zero_for_any_direction() -> None:
    turn = rigid_transform(so3_exp([0.02, 0.08, 0.0]), np.zeros(3))
    pairs = make_pairs(turn, known_to=0.05, noise=0.2 * SIGMA)
    found = find_unscaled_motion(pairs, seed=1)
    assert found is not None
    right = UnscaledMotion(inverse(turn)[:3, :3], found.t, np.ones(len(pairs), np.bool_))
    (T_camera_reference,) = propose_scaled_motions(right, pairs)
    assert np.linalg.norm(T_camera_reference[:3, 3]) < 0.002


def test_a_motion_shorter_than_any_parallax_is_measured() -> None:
    step = rigid_transform(np.eye(3), [0.004, 0.0, 0.0])
    pairs = make_pairs(step, known_to=0.05)
    still = UnscaledMotion(np.eye(3), np.array([0.0, 1.0, 0.0]), np.ones(len(pairs), np.bool_))
    T_camera_reference = propose_scaled_motions(still, pairs)[-1]
    np.testing.assert_allclose(T_camera_reference[:3, 3], [-0.004, 0.0, 0.0], atol=2e-4)


def test_points_of_unknown_depth_give_no_scale() -> None:
    pairs = make_pairs(MOTION)
    assert propose_scaled_motions(find_unscaled_motion(pairs, seed=1), pairs) == []
    assert propose_scaled_motions(None, make_pairs(MOTION, known_to=0.05)) == []

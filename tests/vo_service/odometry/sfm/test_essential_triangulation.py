"""Points from two rays."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.sfm.ray_pairs import MOTION, make_cloud, make_pairs, small_vectors
from vo_service.odometry.sfm.essential import triangulate


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

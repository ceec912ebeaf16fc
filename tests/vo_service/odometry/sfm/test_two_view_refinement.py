"""The motion of the least reprojection error."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings

from drivers.core.geometry import Array, inverse, rigid_transform, rotation_angle_rad
from drivers.core.geometry import so3_exp as turn_by
from tests.vo_service.odometry.sfm.ray_pairs import (
    MOTION,
    SIGMA,
    make_cloud,
    make_pairs,
    small_vectors,
)
from vo_service.odometry.sfm.scale import apply_scale
from vo_service.odometry.sfm.two_view_refinement import refine_best_guess, refine_two_view


@settings(max_examples=15)
@given(small_vectors(0.03), small_vectors(0.05))
def test_a_wrong_guess_converges_to_the_motion(turn: Array, shift: Array) -> None:
    guess = inverse(MOTION @ rigid_transform(turn_by(turn), shift))
    refined = refine_two_view(guess, make_pairs(MOTION, known_to=0.02))
    error = refined.T_camera_reference @ MOTION
    assert np.linalg.norm(error[:3, 3]) < 1e-3
    assert refined.inlier.all()


def test_wrong_pairs_are_removed_and_have_no_effect() -> None:
    pairs = make_pairs(MOTION, known_to=0.02, noise=0.5 * SIGMA)
    ray = pairs.ray.copy()
    ray[:40, 0] += 30 * SIGMA
    refined = refine_two_view(np.eye(4), replace(pairs, ray=ray))
    error = refined.T_camera_reference @ MOTION
    assert np.linalg.norm(error[:3, 3]) < 0.01
    assert not refined.inlier[:40].any()
    assert refined.inlier[40:].mean() > 0.9


def test_points_of_unknown_depth_are_estimated_with_the_motion() -> None:
    pairs = make_pairs(MOTION, known_to=0.01)
    is_new = np.arange(len(pairs)) % 2 == 0
    information = np.where(is_new, 0.0, pairs.information)
    refined = refine_best_guess([np.eye(4)], replace(pairs, information=information))
    np.testing.assert_allclose(
        refined.inverse_depth[is_new], 1.0 / make_cloud()[is_new, 2], rtol=0.02
    )
    assert (refined.information[is_new] > 0.0).all()


def test_the_error_has_the_size_of_the_covariance() -> None:
    refined = refine_two_view(
        inverse(MOTION), make_pairs(MOTION, known_to=0.005, noise=SIGMA / np.sqrt(2))
    )
    error = refined.T_camera_reference @ MOTION
    covariance = refined.covariance
    assert np.linalg.norm(error[:3, 3]) < 4 * np.sqrt(np.trace(covariance[:3, :3]))
    assert rotation_angle_rad(error[:3, :3]) < 4 * np.sqrt(np.trace(covariance[3:, 3:]))
    assert np.sqrt(np.trace(covariance[:3, :3])) < 0.02
    assert np.linalg.eigvalsh(covariance).min() > 0.0


def test_an_unconstrained_parameter_has_a_finite_error() -> None:
    nothing = make_pairs(np.eye(4), count=0)
    refined = refine_two_view(np.eye(4), make_pairs(np.eye(4)))
    assert np.isfinite(refined.covariance).all()
    assert np.linalg.eigvalsh(refined.covariance).max() <= 1.0 + 1e-9
    assert len(nothing) == 0


def test_a_given_length_scales_everything_except_the_rotation() -> None:
    unit = refine_two_view(inverse(MOTION), make_pairs(MOTION, known_to=0.02))
    metres = apply_scale(unit, 2.0)
    np.testing.assert_allclose(
        metres.T_camera_reference[:3, 3], 2.0 * unit.T_camera_reference[:3, 3]
    )
    np.testing.assert_allclose(metres.inverse_depth, unit.inverse_depth / 2.0)
    along = metres.T_camera_reference[:3, 3]
    assert along @ metres.covariance[:3, :3] @ along < 1e-12

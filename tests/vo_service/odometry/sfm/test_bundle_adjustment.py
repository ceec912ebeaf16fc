"""Bundle adjustment."""

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse, is_rigid, rigid_transform, so3_exp
from tests.vo_service.odometry.sfm.ray_pairs import SIGMA, make_cloud, project_rays
from vo_service.odometry.sfm.bundle_adjustment import (
    BundleObservations,
    BundleResult,
    adjust_bundle,
)

POINTS = 80
POSES = [
    rigid_transform(so3_exp([0.01 * k, -0.03 * k, 0.01 * k]), [0.12 * k, 0.0, 0.02 * k])
    for k in range(4)
]


def observations(noise: float = 0.0) -> BundleObservations:
    """Every camera sees every point."""
    seen = np.array([project_rays(inverse(T), make_cloud(POINTS))[:, :2] for T in POSES])
    seen += np.random.default_rng(5).normal(0.0, 1.0, seen.shape) * noise
    view = np.tile(np.arange(len(POSES)), POINTS)
    point = np.repeat(np.arange(POINTS), len(POSES))
    return BundleObservations(view, point, seen[view, point], SIGMA)


def adjusted_from_afar(seen: BundleObservations) -> BundleResult:
    """Poses and points off by a few centimeters and degrees; the first pose is right."""
    random = np.random.default_rng(3)
    T = [inverse(POSES[0])]
    for pose in POSES[1:]:
        off = rigid_transform(so3_exp(random.normal(0.0, 0.01, 3)), random.normal(0.0, 0.02, 3))
        T.append(off @ inverse(pose))
    return adjust_bundle(
        np.array(T), make_cloud(POINTS) + random.normal(0.0, 0.05, (POINTS, 3)), seen
    )


def shape(adjusted: BundleResult) -> Array:
    """Positions of the cameras, scaled to a distance of 1, as the scale is free."""
    places = np.array([inverse(T)[:3, 3] for T in adjusted.T_view_world])
    scaled: Array = places / np.linalg.norm(places[-1])
    return scaled


@pytest.mark.slow
def test_poses_and_points_converge_to_the_observations() -> None:
    adjusted = adjusted_from_afar(observations())
    truth = np.array([T[:3, 3] for T in POSES])
    np.testing.assert_allclose(shape(adjusted), truth / np.linalg.norm(truth[-1]), atol=2e-3)
    assert adjusted.squared_error.max() < 0.1


def test_the_first_pose_is_fixed() -> None:
    adjusted = adjusted_from_afar(observations(noise=SIGMA))
    assert np.array_equal(adjusted.T_view_world[0], inverse(POSES[0]))


def test_an_outlier_has_a_large_error_and_no_effect() -> None:
    seen = observations()
    seen.ray[::40] += 40 * SIGMA
    adjusted = adjusted_from_afar(seen)
    is_wrong = np.zeros(len(seen.view_index), np.bool_)
    is_wrong[::40] = True
    assert adjusted.squared_error[is_wrong].min() > 9.0
    assert np.median(adjusted.squared_error[~is_wrong]) < 0.5


def test_rounding_errors_of_poses_are_removed() -> None:
    T = np.array([inverse(pose) for pose in POSES])
    T[1:, :3, :3] += 1e-6
    adjusted = adjust_bundle(T, make_cloud(POINTS), observations())
    assert all(is_rigid(each, tolerance=1e-14) for each in adjusted.T_view_world)


def test_a_point_behind_a_camera_is_no_error() -> None:
    points = make_cloud(POINTS)
    points[0, 2] = -1.0
    adjusted = adjust_bundle(np.array([inverse(T) for T in POSES]), points, observations())
    assert np.isfinite(adjusted.T_view_world).all()
    assert np.isfinite(adjusted.position_m).all()

"""What every method promises of its estimates, on views that suit it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse
from tests.vo_service.odometry.direct import rolling_shutter_views
from tests.vo_service.odometry.estimate_checks import (
    assert_counts_consistent,
    assert_starts_at_origin,
)
from tests.vo_service.odometry.hand_held_sequence import estimate_all, hand_held_poses
from tests.vo_service.odometry.icp import depth_views
from tests.vo_service.odometry.sfm.sideways_sequence import render_views, sideways_pose
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service import METHODS, make_odometry
from vo_service.types.estimate import Estimate

BRISK = rolling_shutter_views.BRISK


def room_views() -> list[RgbdFrame]:
    poses = map(depth_views.hand_held_pose, range(8))
    views = [depth_views.render_view(depth_views.ROOM, T, k) for k, T in enumerate(poses)]
    return [depth_views.add_noise(view, seed=k) for k, view in enumerate(views)]


def rolling_views() -> list[RgbdFrame]:
    views = rolling_shutter_views.render_sequence(BRISK, 8, 0.02)
    return [rolling_shutter_views.add_noise(view, k) for k, view in enumerate(views)]


@dataclass(frozen=True)
class Walk:
    """Views, the true pose of each, and limits of inliers and of the standard deviation."""

    views: Callable[[], list[RgbdFrame]]
    true_pose: Callable[[int], Array]
    min_inliers: int
    max_sigma_m: float


WALKS = {
    "surf": Walk(
        lambda: [render_corner(T, seq) for seq, T in enumerate(hand_held_poses(6))],
        lambda k: hand_held_poses(6)[k],
        min_inliers=15,
        max_sigma_m=0.005,
    ),
    "icp": Walk(room_views, depth_views.hand_held_pose, min_inliers=201, max_sigma_m=0.02),
    "sfm": Walk(render_views, sideways_pose, min_inliers=15, max_sigma_m=0.05),
    "direct": Walk(rolling_views, lambda k: BRISK.pose_at(k / 30), 100, max_sigma_m=0.005),
}


@pytest.fixture(scope="module", params=METHODS)
def method(request: pytest.FixtureRequest) -> str:
    """The name of each method."""
    return str(request.param)


@pytest.fixture(scope="module")
def estimates(method: str) -> list[Estimate]:
    """The estimates of the method's walk."""
    return estimate_all(make_odometry(method), WALKS[method].views())


def test_the_first_frame_is_the_origin(estimates: list[Estimate]) -> None:
    assert_starts_at_origin(estimates[0])


def test_motions_are_relative_to_the_last_reference_frame(estimates: list[Estimate]) -> None:
    T_world_reference = np.eye(4)
    for estimate in estimates:
        T = T_world_reference @ estimate.T_reference_camera
        np.testing.assert_allclose(estimate.T_world_camera, T, atol=1e-9)
        if estimate.is_next_reference:
            T_world_reference = estimate.T_world_camera


def test_an_estimate_has_its_numbers_of_points(method: str, estimates: list[Estimate]) -> None:
    assert_counts_consistent(estimates[-1], WALKS[method].min_inliers)
    pixels, camera = estimates[-1].debug.keypoints_px, WALKS[method].views()[-1].camera
    assert pixels.min() > -1
    assert (pixels.max(axis=0) < (camera.width, camera.height)).all()


def test_the_error_has_the_size_of_the_covariance(method: str, estimates: list[Estimate]) -> None:
    walk, reference, errors_m, sigmas_m = WALKS[method], 0, [], []
    for k, estimate in enumerate(estimates):
        if k and estimate.ok and estimates[k - 1].ok:
            T_reference_camera = inverse(walk.true_pose(reference)) @ walk.true_pose(k)
            error = inverse(estimate.T_reference_camera) @ T_reference_camera
            errors_m.append(np.linalg.norm(error[:3, 3]))
            sigmas_m.append(np.sqrt(np.trace(estimate.covariance[:3, :3])))
        reference = k if estimate.is_next_reference else reference
    assert len(errors_m) >= 3
    assert max(sigmas_m) < walk.max_sigma_m
    assert np.all(np.array(errors_m) < 4 * np.array(sigmas_m))


@pytest.mark.slow
def test_the_same_frames_give_the_same_bits(method: str, estimates: list[Estimate]) -> None:
    again = estimate_all(make_odometry(method), WALKS[method].views())
    for one, other in zip(estimates, again, strict=True):
        assert np.array_equal(one.T_world_camera, other.T_world_camera)
        assert np.array_equal(one.T_reference_camera, other.T_reference_camera)
        assert np.array_equal(one.covariance, other.covariance)

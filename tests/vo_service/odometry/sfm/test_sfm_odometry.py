"""Structure from motion on a known scene."""

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.sfm.sideways_sequence import (
    FRAMES,
    remove_depth,
    render_view,
    render_views,
    sideways_pose,
)
from tests.vo_service.odometry.synthetic_views import render_corner
from vo_service.odometry.sfm.odometry import SfmOdometry
from vo_service.odometry.sfm.scale import GivenBaselineScale, InitialPair, MetricScale
from vo_service.types.estimate import Estimate


@pytest.fixture(scope="module")
def estimates() -> list[Estimate]:
    return estimate_all(SfmOdometry(), render_views())


def placed(estimates: list[Estimate]) -> list[int]:
    """Numbers of the frames that have a pose, except the first."""
    return [k for k, estimate in enumerate(estimates) if estimate.ok and k > 0]


def test_there_is_no_pose_before_parallax(estimates: list[Estimate]) -> None:
    begin = placed(estimates)[0]
    assert 2 <= begin <= 6
    for estimate in estimates[1:begin]:
        assert not estimate.ok
        assert "waiting for parallax" in estimate.reason
        assert np.array_equal(estimate.T_world_camera, np.eye(4))


def test_after_initialization_every_frame_has_a_metric_pose(estimates: list[Estimate]) -> None:
    begin = placed(estimates)[0]
    assert placed(estimates) == list(range(begin, FRAMES))
    for k in range(begin, FRAMES):
        assert_close(estimates[k].T_world_camera, sideways_pose(k), 0.025, 0.5)


def test_depth_is_used_only_in_the_first_frame(estimates: list[Estimate]) -> None:
    blind = estimate_all(SfmOdometry(), [render_view(0), *map(remove_depth, render_views()[1:])])
    for a, b in zip(estimates, blind, strict=True):
        assert np.array_equal(a.T_world_camera, b.T_world_camera)
        assert np.array_equal(a.covariance, b.covariance)


def test_a_given_baseline_replaces_the_depth() -> None:
    source = GivenBaselineScale(
        lambda from_s, to_s: float(
            np.linalg.norm(2.0 * sideways_pose(round(30 * (to_s - from_s)))[:3, 3])
        )
    )
    estimates = estimate_all(SfmOdometry(scale_source=source), map(remove_depth, render_views(7)))
    assert estimates[-1].ok
    length_m = np.linalg.norm(estimates[-1].T_world_camera[:3, 3])
    assert length_m == pytest.approx(2.0 * np.linalg.norm(sideways_pose(6)[:3, 3]), rel=0.05)


def test_an_uncertain_scale_makes_every_step_length_uncertain(
    estimates: list[Estimate],
) -> None:
    class Unsure:
        name = "a guess"

        def estimate_scale(self, pair: InitialPair) -> MetricScale:
            return MetricScale(0.2, log_sigma=0.5)

    unsure = estimate_all(SfmOdometry(scale_source=Unsure()), render_views())[-1]
    along = inverse(unsure.T_reference_camera)[:3, 3]
    length_m = float(np.linalg.norm(along))
    variance = along @ unsure.covariance[:3, :3] @ along / length_m**2
    assert np.sqrt(variance) > 0.5 * length_m


def turning(k: int) -> RgbdFrame:
    """After the walk, a turn on the spot."""
    turn = rigid_transform(so3_exp([0.0, -0.02 * k, 0.01 * k]), np.zeros(3))
    return render_corner(sideways_pose(FRAMES - 1) @ turn, FRAMES + k)


def test_a_pure_rotation_translates_nothing() -> None:
    odometry = SfmOdometry()
    last = estimate_all(odometry, render_views())[-1]
    for k, estimate in enumerate(estimate_all(odometry, map(turning, range(1, 4))), 1):
        assert estimate.ok, estimate.reason
        step = inverse(last.T_world_camera) @ estimate.T_world_camera
        assert_close(
            step,
            rigid_transform(so3_exp([0.0, -0.02 * k, 0.01 * k]), np.zeros(3)),
            0.01,
            0.3,
        )


def test_a_camera_at_rest_has_no_motion() -> None:
    odometry = SfmOdometry()
    moved = estimate_all(odometry, render_views())[-1]
    for estimate in estimate_all(odometry, [render_view(FRAMES - 1)] * 3):
        assert estimate.ok
        assert_close(estimate.T_world_camera, moved.T_world_camera, 0.005, 0.1)

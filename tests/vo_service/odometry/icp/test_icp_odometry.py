"""Accuracy and failures of the ICP odometry."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import RgbdFrame
from drivers.core.geometry import rigid_transform, so3_exp
from tests.vo_service.odometry.estimate_checks import (
    assert_valid_or_explained,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from tests.vo_service.odometry.icp.depth_views import (
    CAMERA,
    FLOOR,
    ROOM,
    WALL,
    Plane,
    add_noise,
    hand_held_pose,
    make_frame,
    remove_blocks,
    render_view,
)
from tests.vo_service.odometry.recording_stage_timer import RecordingStageTimer
from vo_service.odometry.icp.odometry import IcpOdometry, IcpParameters

NO_DEPTH = make_frame(np.zeros((CAMERA.height, CAMERA.width)))


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [add_noise(render_view(ROOM, hand_held_pose(k), k), seed=k) for k in range(8)]


def test_a_camera_in_a_corner_of_a_room_is_tracked_by_depth_only(views: list[RgbdFrame]) -> None:
    for k, estimate in enumerate(estimate_all(IcpOdometry(), views)):
        assert estimate.ok, estimate.reason
        assert_close(estimate.T_world_camera, hand_held_pose(k), 0.004, 0.2)


def test_a_camera_at_rest_does_not_drift() -> None:
    still = [add_noise(render_view(ROOM, np.eye(4), k), seed=k) for k in range(30)]
    for estimate in estimate_all(IcpOdometry(), still)[1:]:
        assert_close(estimate.T_world_camera, np.eye(4), 0.003, 0.12)


def test_frozen_frames_are_no_motion(views: list[RgbdFrame]) -> None:
    estimates = estimate_all(IcpOdometry(), [views[0]] * 10)
    assert all(e.ok for e in estimates)
    assert_close(estimates[-1].T_world_camera, np.eye(4), 0.003, 0.1)
    assert_close(estimates[-1].T_world_camera, estimates[2].T_world_camera, 0.0002, 0.01)


def test_fast_motion_is_tracked() -> None:
    frames = [render_view(ROOM, hand_held_pose(3 * k), k) for k in range(5)]
    estimates = estimate_all(IcpOdometry(), frames)
    assert all(e.ok for e in estimates)
    assert_close(estimates[-1].T_world_camera, hand_held_pose(12), 0.006, 0.2)


def test_half_of_the_depth_may_be_missing(views: list[RgbdFrame]) -> None:
    estimates = estimate_all(IcpOdometry(), [remove_blocks(v, 0.5, k) for k, v in enumerate(views)])
    assert [e.reason for e in estimates if not e.ok] == []
    assert_close(estimates[-1].T_world_camera, hand_held_pose(7), 0.01, 0.4)


def test_a_long_trajectory_uses_several_references() -> None:
    stages = RecordingStageTimer()
    estimates = estimate_all(
        IcpOdometry(timer=stages), [render_view(ROOM, hand_held_pose(2 * k), k) for k in range(18)]
    )
    assert all(e.ok for e in estimates)
    assert stages.names.count("planes") > 2
    assert_close(estimates[-1].T_world_camera, hand_held_pose(34), 0.006, 0.2)


@pytest.mark.parametrize(("planes", "unknown"), [((WALL,), 3), ((WALL, FLOOR), 1)])
def test_a_degenerate_view_is_not_a_start(planes: Sequence[Plane], unknown: int) -> None:
    frame = add_noise(render_view(planes, np.eye(4)), seed=0)
    estimate = IcpOdometry().estimate(frame)
    assert not estimate.ok
    assert estimate.reason.startswith(f"cannot start: degenerate view: depth leaves {unknown} of")


def test_it_does_not_slide_along_a_single_wall(views: list[RgbdFrame]) -> None:
    odometry = IcpOdometry()
    before = odometry.estimate(views[0])
    along = [rigid_transform(np.eye(3), [0.02 * k, 0.0, 0.0]) for k in range(1, 4)]
    for k, T in enumerate(along, 1):
        estimate = odometry.estimate(add_noise(render_view((WALL,), T, k), seed=k))
        assert not estimate.ok
        assert np.array_equal(estimate.T_world_camera, before.T_world_camera)
    after = odometry.estimate(views[4])
    assert after.ok
    assert_close(after.T_world_camera, hand_held_pose(4), 0.004, 0.2)


def test_a_temporarily_unconstrained_direction_does_not_drift() -> None:
    odometry = IcpOdometry()
    sure = estimate_all(
        odometry, [add_noise(render_view(ROOM, hand_held_pose(k), k), k) for k in range(4)]
    )[-1]
    # The side wall has no depth for three frames; the camera goes on.
    for k in range(4, 7):
        flat = odometry.estimate(
            without_the_right(add_noise(render_view(ROOM, hand_held_pose(k), k), k))
        )
        assert "leaves 1 of 6 degrees of freedom unconstrained" in flat.reason
        assert np.array_equal(flat.T_world_camera, sure.T_world_camera)
    found = odometry.estimate(add_noise(render_view(ROOM, hand_held_pose(7), 7), 7))
    assert found.ok
    assert_close(found.T_world_camera, hand_held_pose(7), 0.004, 0.2)


def without_the_right(frame: RgbdFrame) -> RgbdFrame:
    depth_m = frame.depth_m.astype(np.float64)
    depth_m[:, 180:] = 0.0
    return make_frame(depth_m, frame.seq)


def test_a_frame_without_depth_fails_and_is_skipped(views: list[RgbdFrame]) -> None:
    odometry = IcpOdometry()
    assert odometry.estimate(NO_DEPTH).reason.startswith("cannot start: only 0 of 0 surface points")
    first, failed, after = estimate_all(odometry, [views[0], NO_DEPTH, views[2]])
    assert first.ok
    assert not failed.ok
    assert "surface points are in view" in failed.reason
    assert np.array_equal(failed.T_reference_camera, np.eye(4))
    assert after.ok
    assert_close(after.T_reference_camera, hand_held_pose(2), 0.004, 0.2)


def test_after_too_many_failures_tracking_restarts(views: list[RgbdFrame]) -> None:
    odometry = IcpOdometry(IcpParameters(max_failures=2))
    before = estimate_all(odometry, views[:2])[1]
    away = rigid_transform(so3_exp([0.0, 0.0, 3.0]), np.zeros(3))
    turned = [render_view(ROOM, away @ hand_held_pose(k), k) for k in range(2)]
    lost = estimate_all(odometry, [NO_DEPTH, turned[0], *turned])
    assert [e.ok for e in lost] == [False, False, True, True]
    assert [e.is_reset for e in lost] == [False, False, True, False]
    assert np.array_equal(lost[2].T_world_camera, before.T_world_camera)
    assert_close(lost[3].T_reference_camera, hand_held_pose(1), 0.004, 0.2)


@settings(deadline=None, max_examples=20)
@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 4)), min_size=2, max_size=4))
def test_no_frame_raises_and_every_pose_is_rigid(kinds: list[tuple[int, int]]) -> None:
    odometry = IcpOdometry(IcpParameters(max_failures=1))
    for seed, kind in kinds:
        estimate = odometry.estimate(garbage(seed, kind))
        assert_valid_or_explained(estimate)


def garbage(seed: int, kind: int) -> RgbdFrame:
    """Noise, a few dots, a line, a flat wall or half a room."""
    random = np.random.default_rng(seed)
    shape = (CAMERA.height, CAMERA.width)
    depth_m = random.uniform(0.0, 5.0, shape) if kind == 0 else np.zeros(shape)
    if kind == 1:
        depth_m[random.uniform(size=shape) < 0.01] = 1.0
    elif kind == 2:
        depth_m[40 : 40 + seed % 20] = 1.5
    elif kind == 3:
        depth_m[:] = 0.01 + seed % 7
    elif kind == 4:
        return remove_blocks(render_view(ROOM, hand_held_pose(seed % 50), seed % 9), 0.5, seed)
    return make_frame(depth_m)

"""Frames without a motion give a valid estimate, never an error."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.camera import RgbdFrame
from drivers.core.geometry import inverse
from tests.vo_service.odometry.estimate_checks import assert_valid
from tests.vo_service.odometry.hand_held_sequence import (
    BLACK,
    SHAPE,
    assert_close,
    estimate_all,
    hand_held_poses,
    render_elsewhere,
)
from tests.vo_service.odometry.synthetic_views import (
    CAMERA,
    FIRST_CALL_COMPILES,
    make_frame,
    render_corner,
)
from vo_service.odometry.features.parameters import SurfParameters
from vo_service.odometry.surf.odometry import SurfOdometry


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [render_corner(T, seq) for seq, T in enumerate(hand_held_poses(6))]


def test_a_black_start_fails_and_the_next_good_frame_starts(views: list[RgbdFrame]) -> None:
    black, first, second = estimate_all(SurfOdometry(), [BLACK, views[0], views[1]])
    assert not black.ok
    assert "too few features with depth" in black.reason
    assert first.ok
    assert np.array_equal(first.T_world_camera, np.eye(4))
    assert_close(second.T_world_camera, hand_held_poses(2)[1], 0.004, 0.2)


def test_a_failed_frame_keeps_the_pose_and_is_skipped(
    views: list[RgbdFrame],
) -> None:
    _, before, failed, after = estimate_all(SurfOdometry(), [views[0], views[1], BLACK, views[3]])
    assert not failed.ok
    assert "0 of 0 matches agree" in failed.reason
    assert np.array_equal(failed.T_world_camera, before.T_world_camera)
    assert np.array_equal(failed.T_reference_camera, np.eye(4))
    assert not failed.is_reset
    assert after.ok
    assert_close(after.T_world_camera, hand_held_poses(4)[3], 0.006, 0.3)
    assert_close(
        after.T_reference_camera, inverse(hand_held_poses(4)[1]) @ hand_held_poses(4)[3], 0.004, 0.2
    )


def test_after_too_many_failures_tracking_restarts(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=2))
    before = estimate_all(odometry, views[:2])[1]
    lost = estimate_all(
        odometry, [BLACK, render_elsewhere(0), render_elsewhere(1), render_elsewhere(2)]
    )
    assert [e.ok for e in lost] == [False, False, True, True]
    assert [e.is_reset for e in lost] == [False, False, True, False]
    assert np.array_equal(lost[2].T_world_camera, before.T_world_camera)
    step = inverse(lost[2].T_world_camera) @ lost[3].T_world_camera
    assert_close(step, inverse(hand_held_poses(3)[1]) @ hand_held_poses(3)[2], 0.004, 0.2)


def test_without_features_it_does_not_restart(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=2))
    estimate_all(odometry, views[:1])
    lost = estimate_all(odometry, [BLACK] * 5)
    assert not any(e.ok or e.is_reset for e in lost)
    # The last good view was never given up: tracking goes on from it.
    found = odometry.estimate(views[1])
    assert found.ok
    assert not found.is_reset
    assert_close(found.T_world_camera, hand_held_poses(2)[1], 0.004, 0.2)


def test_a_failure_does_not_count_for_the_next_loss(views: list[RgbdFrame]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=1))
    estimates = estimate_all(odometry, [views[0], BLACK, views[1], render_elsewhere(0), views[2]])
    assert [e.ok for e in estimates] == [True, False, True, False, True]
    assert not any(e.is_reset for e in estimates)


def test_frames_without_depth_fail_with_a_reason(views: list[RgbdFrame]) -> None:
    no_depth = RgbdFrame(
        0, 0.0, 0.0, views[1].color_bgr, np.zeros(SHAPE, np.uint16), 5000.0, CAMERA
    )
    _, failed = estimate_all(SurfOdometry(), [views[0], no_depth])
    assert not failed.ok
    assert not SurfOdometry().estimate(no_depth).ok


@settings(FIRST_CALL_COMPILES, max_examples=25)
@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 5)), min_size=2, max_size=4))
def test_no_frame_raises_and_every_pose_is_rigid(kinds: list[tuple[int, int]]) -> None:
    odometry = SurfOdometry(parameters=SurfParameters(max_failures=1))
    for seed, kind in kinds:
        estimate = odometry.estimate(garbage(seed, kind))
        assert_valid(estimate)


def garbage(seed: int, kind: int) -> RgbdFrame:
    """Noise, stripes, dots on a line or nothing, with depth that is noise, a plane or none."""
    random = np.random.default_rng(seed)
    gray = np.full(SHAPE, seed % 256, np.uint8)
    if kind in (0, 1):
        gray = random.integers(0, 256, SHAPE, dtype=np.uint8)
    elif kind == 2:
        gray[:, ::9] = 255 - seed % 256
    elif kind == 3:
        gray[118:124, 30:300:12] = 255 - seed % 256
    depth_m = random.uniform(0.0, 5.0, SHAPE) if kind == 0 else np.full(SHAPE, seed % 3 * 0.9)
    return make_frame(gray, depth_m)

"""Accuracy of the direct odometry."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    STILL,
    MovingCamera,
    add_noise,
    render_sequence,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.types.estimate import Estimate

TIMINGS = [(0.0, 0.0), (0.02, 0.01), (0.02, -0.012)]


def positions_of(estimates: list[Estimate]) -> Array:
    """(N, 3) positions."""
    return np.array([e.T_world_camera[:3, 3] for e in estimates])


@pytest.fixture(scope="module")
def views() -> list[RgbdFrame]:
    return [add_noise(frame, k) for k, frame in enumerate(render_sequence(BRISK, 8))]


@pytest.mark.parametrize(("readout_s", "skew_s"), TIMINGS)
def test_a_camera_in_a_corner_is_tracked(readout_s: float, skew_s: float) -> None:
    frames = render_sequence(BRISK, 6, readout_s, skew_s)
    for k, estimate in enumerate(estimate_all(DirectOdometry(), frames)):
        assert estimate.ok
        assert estimate.reason == ""
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.0006, 0.02)


def test_noise_changes_poses_little_and_does_not_accumulate(views: list[RgbdFrame]) -> None:
    for k, estimate in enumerate(estimate_all(DirectOdometry(), views)):
        assert_close(estimate.T_world_camera, BRISK.pose_at(k / 30), 0.0015, 0.05)


def test_ignoring_the_rolling_shutter_increases_the_error() -> None:
    """A camera at rest that starts to move is tracked less accurately without its timing."""
    still = [render_view(stamp_s=k / 30 - 1.0, readout_s=0.03, skew_s=0.015) for k in range(28, 30)]
    rolling = still + render_sequence(BRISK, 5, 0.03, 0.015)
    blind = [replace(frame, readout_s=0.0, skew_s=0.0) for frame in rolling]
    with_motion, without_timing = (
        np.linalg.norm(
            positions_of(estimate_all(DirectOdometry(), each))[-1] - BRISK.pose_at(4 / 30)[:3, 3]
        )
        for each in (rolling, blind)
    )
    assert with_motion < 1e-3
    assert without_timing > 3 * with_motion


def test_frozen_frames_are_no_motion(views: list[RgbdFrame]) -> None:
    estimates = estimate_all(DirectOdometry(), [views[0]] * 40)
    assert all(e.ok for e in estimates)
    # By its noise the frame is slightly off the keyframe's smooth planes; the pose converges there.
    assert_close(estimates[-1].T_world_camera, np.eye(4), 4e-4, 0.01)
    assert_close(estimates[-1].T_world_camera, estimates[-2].T_world_camera, 1e-5, 1e-3)


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_a_camera_at_rest_does_not_drift_and_needs_no_new_keyframe(readout_s: float) -> None:
    frame = render_view(readout_s=readout_s)
    still = [replace(add_noise(frame, k), stamp_s=k / 30) for k in range(60)]
    estimates = estimate_all(DirectOdometry(), still)
    assert all(e.ok for e in estimates)
    # With a rolling shutter the first keyframe is rebuilt once.
    assert not any(e.is_next_reference for e in estimates[2:])
    positions = positions_of(estimates)
    assert np.linalg.norm(positions[40:].mean(axis=0) - positions[5:25].mean(axis=0)) < 3e-4
    assert np.linalg.norm(positions, axis=1).max() < 1.5e-3
    # A single frame is accurate to 0.15 mm; the filter averages many.
    assert positions[30:].std(axis=0).max() < 7e-5


@pytest.mark.slow
def test_a_start_from_rest_is_tracked_at_once() -> None:
    going = MovingCamera(np.array([0.012, 0.0, 0.016, 0.0, 0.0, 0.0]))
    rest = [render_view(readout_s=0.02) for _ in range(20)]
    frames = [*rest, *render_sequence(going, 10, 0.02)]
    frames = [replace(add_noise(frame, k), stamp_s=k / 30) for k, frame in enumerate(frames)]
    positions = positions_of(estimate_all(DirectOdometry(), frames)) @ [0.6, 0.0, 0.8]
    # 0.7 mm a frame: never more than a frame late.
    np.testing.assert_allclose(
        positions[20:] - positions[10:20].mean(), 0.02 * np.arange(10) / 30, atol=0.7e-3
    )


@pytest.mark.slow
def test_slow_motion_is_tracked() -> None:
    slow = MovingCamera(np.array([0.9e-3, 0.0, 1.2e-3, 0.0, 0.0, 0.0]))
    frames = [add_noise(frame, k) for k, frame in enumerate(render_sequence(slow, 50))]
    positions = positions_of(estimate_all(DirectOdometry(), frames))
    gone_m = np.linalg.norm(positions[40:].mean(axis=0) - positions[:10].mean(axis=0))
    # 0.05 mm a frame, over forty.
    assert gone_m == pytest.approx(40 * 5e-5, rel=0.35)


def looking(angle_rad: float, k: int) -> RgbdFrame:
    return add_noise(render_view(MovingCamera(T_world_start=turned(angle_rad)), k / 30), k)


def turned(angle_rad: float) -> Array:
    turn = so3_exp([0.0, angle_rad, 0.0])
    return rigid_transform(turn, [0.3 * angle_rad, 0.0, 0.0])


def sweep() -> list[float]:
    there = [0.06 * k for k in range(9)]
    return there + there[::-1]


@pytest.fixture(scope="module")
def swept() -> list[Estimate]:
    """The camera rotates aside and back."""
    return estimate_all(DirectOdometry(), [looking(a, k) for k, a in enumerate(sweep())])


def test_a_long_trajectory_uses_several_keyframes(swept: list[Estimate]) -> None:
    assert all(e.ok for e in swept)
    assert sum(e.is_next_reference for e in swept[:9]) >= 3
    for angle_rad, estimate in zip(sweep(), swept, strict=True):
        assert_close(estimate.T_world_camera, turned(angle_rad), 0.003, 0.08)


def test_a_returning_view_reuses_its_old_keyframe(
    swept: list[Estimate],
) -> None:
    """So the error does not accumulate on the way there and back."""
    assert_close(swept[-1].T_world_camera, np.eye(4), 0.0012, 0.04)


def test_motions_are_relative_to_the_last_reference_frame(swept: list[Estimate]) -> None:
    reference = swept[0]
    for estimate in swept[1:]:
        T = reference.T_world_camera @ estimate.T_reference_camera
        np.testing.assert_allclose(estimate.T_world_camera, T, atol=1e-9)
        if estimate.is_next_reference:
            reference = estimate


def test_fast_motion_at_a_low_rate_is_tracked() -> None:
    fast = MovingCamera(np.array([0.5, -0.3, 0.4, -0.5, 0.8, 0.6]))
    frames = [add_noise(render_view(fast, k / 10), k) for k in range(4)]
    estimates = estimate_all(DirectOdometry(), frames)
    assert [e.reason for e in estimates if not e.ok] == []
    assert_close(estimates[-1].T_world_camera, fast.pose_at(0.3), 0.003, 0.1)


def test_tracking_continues_after_missing_frames() -> None:
    times_s = [0.0, 1 / 30, 2 / 30, 0.6, 0.6 + 1 / 30, 0.2 + 1.0]
    frames = [add_noise(render_view(BRISK, t), k) for k, t in enumerate(times_s)]
    for t, estimate in zip(times_s, estimate_all(DirectOdometry(), frames), strict=True):
        assert estimate.ok
        assert_close(estimate.T_world_camera, BRISK.pose_at(t), 0.003, 0.1)


def test_poses_stay_rigid_to_rounding(swept: list[Estimate]) -> None:
    for before, after in pairwise(swept):
        for T in (after.T_world_camera, inverse(before.T_world_camera) @ after.T_world_camera):
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)


def test_a_camera_at_rest_from_the_start_has_no_velocity() -> None:
    frames = [
        replace(add_noise(render_view(STILL, readout_s=0.02), k), stamp_s=k / 30) for k in range(3)
    ]
    for estimate in estimate_all(DirectOdometry(), frames):
        assert_close(estimate.T_world_camera, np.eye(4), 0.001, 0.03)


class Trembling(MovingCamera):
    """A camera that rotates aside, with hand tremor at 5 Hz."""

    def poses_at(self, times_s: Array) -> Array:
        return np.array([self._trembling_pose_at(time_s) for time_s in times_s.tolist()])

    def _trembling_pose_at(self, time_s: float) -> Array:
        tremor_rad = 0.015 * np.sin(2 * np.pi * 5.0 * time_s) * np.array([1.0, 0.6, -0.5])
        turn = np.array([0.0, 0.9, 0.0]) * (time_s - 0.5) + tremor_rad
        return rigid_transform(so3_exp(turn), np.array([0.25, 0.05, 0.1]) * time_s)


def drift_of(frames: list[RgbdFrame]) -> float:
    """Mean distance from the true trajectory, m."""
    positions = positions_of(estimate_all(DirectOdometry(), frames))
    T_start_world = inverse(Trembling().pose_at(0.0))
    truth = [(T_start_world @ Trembling().pose_at(frame.stamp_s))[:3, 3] for frame in frames]
    return float(np.linalg.norm(positions - truth, axis=1).mean())


@pytest.mark.slow
def test_a_trembling_hand_does_not_distort_keyframes() -> None:
    """Keyframes are corrected by the poses around them, not by distorted keyframes before."""
    frames = [add_noise(f, k) for k, f in enumerate(render_sequence(Trembling(), 36, 0.02, 0.012))]
    assert drift_of(frames) < 0.001

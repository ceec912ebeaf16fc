"""Degenerate views are tracked for a short time, and reported."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import inverse
from tests.vo_service.odometry.direct.rolling_shutter_views import (
    BRISK,
    WALL,
    MovingCamera,
    add_noise,
    remove_color,
    render_view,
)
from tests.vo_service.odometry.hand_held_sequence import assert_close, estimate_all
from vo_service.odometry.direct import points
from vo_service.odometry.direct.motion import se3_log
from vo_service.odometry.direct.odometry import DirectOdometry
from vo_service.odometry.direct.parameters import MAX_EXTRAPOLATION_S

REASON = "degenerate view: 3 of 6 degrees of freedom are unconstrained"
# 99 of 100 normalized squares of a motion's six errors are below it.
CHI_SQUARED_99 = 16.8


@pytest.mark.parametrize("times", [0.0, 1.0])
def test_a_bare_wall_is_not_a_start_and_causes_no_sliding(times: float) -> None:
    odometry = DirectOdometry()
    bare = [add_noise(render_view(BRISK, k / 30, (WALL,), paint=0.0), k, times) for k in range(4)]
    first = odometry.estimate(bare[0])
    assert first.reason == f"cannot start: {REASON}"
    assert not first.ok
    wall = [add_noise(render_view(BRISK, k / 30, (WALL,)), k, times) for k in range(6)]
    before = estimate_all(odometry, wall[:2])[1]
    lost = estimate_all(odometry, bare[2:])
    assert not any(e.ok for e in lost)
    np.testing.assert_array_equal(lost[-1].T_world_camera, before.T_world_camera)
    assert odometry.estimate(wall[4]).ok


def test_degenerate_views_after_the_first_frame_are_as_uncertain_as_the_unknown_velocity() -> None:
    odometry, fast = DirectOdometry(), MovingCamera(2.0 * BRISK.velocity)
    wall = [add_noise(render_view(fast, k / 30, (WALL,)), k) for k in range(6)]
    assert odometry.well_constrained_stamp_s == -np.inf
    odometry.estimate(wall[0])
    dark = estimate_all(odometry, [remove_color(frame) for frame in wall[1:]])
    assert {estimate.reason for estimate in dark} == {REASON}
    assert odometry.well_constrained_stamp_s == wall[0].stamp_s
    for k, estimate in enumerate(dark, start=1):
        off = inverse(estimate.T_world_camera) @ fast.pose_at(k / 30)
        sigma_m = np.sqrt(np.linalg.eigvalsh(estimate.covariance[:3, :3])[-1])
        assert np.linalg.norm(off[:3, 3]) < 3.0 * sigma_m


def test_a_jump_towards_a_wall_in_the_dark_is_lost() -> None:
    """Something that moves before the camera looks like that."""
    odometry = DirectOdometry()
    wall = [add_noise(render_view(BRISK, k / 30, (WALL,)), k) for k in range(6)]
    estimate_all(odometry, wall[:4])
    dark, jumped = remove_color(wall[4]), MovingCamera(T_world_start=BRISK.pose_at(5 / 30))
    jumped.T_world_start[2, 3] += 0.15
    frame = add_noise(render_view(jumped, 0.0, (WALL,), paint=0.0), 5)
    moved, lost = estimate_all(odometry, [dark, remove_color(replace(frame, stamp_s=5 / 30))])
    assert (moved.ok, moved.reason) == (True, REASON)
    assert (lost.ok, lost.reason) == (
        False,
        "degenerate view: the motion contradicts that of the last frames",
    )


@pytest.mark.slow
def test_a_degenerate_view_is_degraded_for_a_moment_then_lost() -> None:
    """A textured wall in the dark: depth constrains three degrees of freedom."""
    odometry = DirectOdometry()
    wall = [add_noise(render_view(BRISK, k / 30, (WALL,)), k) for k in range(18)]
    estimate_all(odometry, wall[:4])
    plain = estimate_all(odometry, [remove_color(frame) for frame in wall[4:]])
    assert {e.reason for e in plain} == {REASON}
    # The last well constrained frame is at 0.1 s.
    assert [e.ok for e in plain] == [k / 30 <= 0.1 + MAX_EXTRAPOLATION_S for k in range(4, 18)]
    for k, estimate in enumerate(plain[:12], start=4):
        off = se3_log(inverse(estimate.T_world_camera) @ BRISK.pose_at(k / 30))
        assert off @ np.linalg.solve(estimate.covariance, off) < CHI_SQUARED_99
    assert np.trace(plain[11].covariance) > 10.0 * np.trace(plain[0].covariance)


def test_texture_that_is_too_faint_for_the_alignment_is_followed_by_features(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    odometry = DirectOdometry()
    wall = [add_noise(render_view(BRISK, k / 30, (WALL,)), k) for k in range(30)]
    estimate_all(odometry, wall[:4])
    monkeypatch.setattr(points, "MIN_TEXTURE_GRADIENTS", (500.0, 500.0))
    estimates = estimate_all(odometry, wall[4:])
    assert all(estimate.ok for estimate in estimates)
    assert {estimate.reason for estimate in estimates[-6:]} == {"degenerate view: features"}
    assert_close(estimates[-1].T_world_camera, BRISK.pose_at(29 / 30), 0.005, 0.2)


@pytest.mark.slow
def test_the_jump_after_extrapolation_does_not_change_the_velocity() -> None:
    """The light goes out, is seen for one frame, and goes out again."""
    odometry, slow = DirectOdometry(), MovingCamera(0.5 * BRISK.velocity)
    wall = [add_noise(render_view(slow, k / 30, (WALL,)), k) for k in range(18)]
    estimate_all(odometry, wall[:4])
    frames = [wall[k] if k == 12 else remove_color(wall[k]) for k in range(4, 18)]
    estimates = estimate_all(odometry, frames)
    assert [k for k, e in enumerate(estimates, start=4) if not e.reason] == [12]
    for k, estimate in enumerate(estimates[8:], start=12):
        assert_close(estimate.T_world_camera, slow.pose_at(k / 30), 0.005, 0.15)


@pytest.mark.slow
def test_a_keyframe_started_in_a_degenerate_view_has_the_covariance_of_the_extrapolation() -> None:
    """Aligned with other keyframes as well, the pose would rotate in front of the wall."""
    odometry, hand = DirectOdometry(), MovingCamera(3.0 * BRISK.velocity)
    wall = [add_noise(render_view(hand, k / 30, (WALL,)), k) for k in range(16)]
    estimate_all(odometry, wall[:8])
    plain = estimate_all(odometry, [remove_color(frame) for frame in wall[8:]])
    assert any(e.is_next_reference for e in plain)
    for k, estimate in enumerate(plain, start=8):
        assert_close(estimate.T_world_camera, hand.pose_at(k / 30), 0.015, 0.15)

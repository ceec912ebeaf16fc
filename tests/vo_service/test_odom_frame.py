"""From a chain of estimates to poses for a robot: axes, mounting, covariance, states, epochs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import R_BODY_OPTICAL, Array, inverse, rigid_transform, so3_exp, so3_log
from tests.vo_service.fakes import STEP_COVARIANCE, failed_estimate, good_estimate
from tests.vo_service.odom_frame_steps import (
    RATE_HZ,
    T_BASE_CAMERA_AHEAD,
    T_BASE_CAMERA_TILTED,
    pose_sigmas,
    rotation_step,
    run_steps,
    translation_step,
    update_frame,
)
from vo_service.odom_frame import OdomFrame
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import TrackingState


@pytest.mark.parametrize(
    ("step", "position_m"),
    [
        (translation_step(forward_m=1.0), [1.0, 0.0, 0.0]),
        (translation_step(right_m=1.0), [0.0, -1.0, 0.0]),
        (translation_step(down_m=1.0), [0.0, 0.0, -1.0]),
    ],
)
def test_the_odom_frame_is_x_forward_y_left_z_up(step: Array, position_m: list[float]) -> None:
    found = run_steps(OdomFrame(), [step])[-1].T_odom_base
    np.testing.assert_allclose(found, rigid_transform(np.eye(3), position_m), atol=1e-12)


def test_the_camera_is_in_odom_where_it_is_mounted_on_the_base() -> None:
    for each in run_steps(
        OdomFrame(T_BASE_CAMERA_TILTED), [translation_step(forward_m=1.0), rotation_step(roll=0.5)]
    ):
        np.testing.assert_allclose(
            each.T_odom_camera, each.T_odom_base @ T_BASE_CAMERA_TILTED, atol=1e-12
        )


@pytest.mark.parametrize(
    ("step", "rotation_rad"),
    [
        (
            rotation_step(yaw_right=0.5),
            [0.0, 0.0, -0.5],
        ),  # to the right is clockwise seen from above
        (rotation_step(pitch=0.5), [0.0, -0.5, 0.0]),  # nose up
        (rotation_step(roll=0.5), [0.5, 0.0, 0.0]),
    ],
)
def test_rotations_follow_the_right_hand_rule_about_odom_axes(
    step: Array, rotation_rad: list[float]
) -> None:
    found = run_steps(OdomFrame(), [step])[-1].T_odom_base
    np.testing.assert_allclose(so3_log(found[:3, :3]), rotation_rad, atol=1e-12)
    np.testing.assert_allclose(found[:3, 3], 0.0, atol=1e-12)


def test_the_pose_for_files_is_that_of_the_optical_camera() -> None:
    updates = run_steps(OdomFrame(T_BASE_CAMERA_TILTED), [translation_step(forward_m=1.0)] * 2)
    np.testing.assert_array_equal(updates[0].T_world_camera, np.eye(4))
    np.testing.assert_array_equal(updates[2].T_world_camera, translation_step(forward_m=2.0))


def test_the_first_base_pose_is_the_origin_of_odom() -> None:
    np.testing.assert_allclose(
        run_steps(OdomFrame(T_BASE_CAMERA_TILTED), [])[0].T_odom_base, np.eye(4), atol=1e-12
    )


def test_a_base_that_rotates_in_place_stays_though_its_camera_moves() -> None:
    left_90 = rigid_transform(so3_exp([0.0, 0.0, np.pi / 2]), np.zeros(3))
    T_world_camera = inverse(T_BASE_CAMERA_AHEAD) @ left_90 @ T_BASE_CAMERA_AHEAD
    # The camera itself swings 30 cm forward (to where its left was) and turns.
    np.testing.assert_allclose(T_world_camera[:3, 3], [-0.3, 0.0, -0.3], atol=1e-12)
    tracker = OdomFrame(T_BASE_CAMERA_AHEAD)
    update_frame(tracker, good_estimate(np.eye(4)), 0)
    found = update_frame(tracker, good_estimate(T_world_camera), 1).T_odom_base
    np.testing.assert_allclose(found, left_90, atol=1e-12)


def test_a_rotating_base_with_an_offset_camera_has_no_linear_velocity() -> None:
    small = rigid_transform(so3_exp([0.0, 0.0, 0.01]), np.zeros(3))
    twist = run_steps(
        OdomFrame(T_BASE_CAMERA_AHEAD), [inverse(T_BASE_CAMERA_AHEAD) @ small @ T_BASE_CAMERA_AHEAD]
    )[-1].twist
    np.testing.assert_allclose(twist[5], 0.01 * RATE_HZ, rtol=1e-9)
    # What is left is the difference between a chord and its arc.
    np.testing.assert_allclose(twist[:5], 0.0, atol=0.3 * 0.01**2 * RATE_HZ)


def test_the_twist_is_the_pose_by_finite_differences_in_the_child_frame() -> None:
    step = translation_step(0.02, 0.005, -0.003) @ rotation_step(0.004, 0.01, -0.006)
    before, after = run_steps(OdomFrame(T_BASE_CAMERA_TILTED), [step] * 7)[-2:]
    delta = inverse(before.T_odom_base) @ after.T_odom_base
    linear = delta[:3, :3].T @ delta[:3, 3] * RATE_HZ
    np.testing.assert_allclose(after.twist[:3], linear, atol=3e-3)
    np.testing.assert_allclose(after.twist[3:], so3_log(delta[:3, :3]) * RATE_HZ, atol=1e-9)


def test_the_twist_over_a_gap_takes_the_time_since_the_last_good_frame() -> None:
    tracker = OdomFrame()
    update_frame(tracker, good_estimate(np.eye(4)), 0)
    update_frame(tracker, failed_estimate(), 1)
    after = update_frame(tracker, good_estimate(translation_step(0.2), translation_step(0.2)), 2)
    np.testing.assert_allclose(after.twist, [0.2 * RATE_HZ / 2, 0, 0, 0, 0, 0], atol=1e-9)


@pytest.mark.parametrize("estimate", [good_estimate(np.eye(4)), failed_estimate()])
def test_an_unknown_velocity_has_a_large_covariance(estimate: Estimate) -> None:
    first = update_frame(OdomFrame(), estimate)
    np.testing.assert_array_equal(first.twist, 0.0)
    assert np.all(np.diag(first.twist_covariance) >= 0.25)


@given(st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 6), max_size=8))
def test_every_covariance_is_finite_symmetric_and_positive(walked: list[tuple[float, ...]]) -> None:
    steps = [rigid_transform(so3_exp(v[:3]), v[3:]) for v in walked]
    for each in run_steps(OdomFrame(T_BASE_CAMERA_TILTED), steps):
        for covariance in (each.pose_covariance, each.twist_covariance):
            np.testing.assert_allclose(covariance, covariance.T, rtol=1e-12, atol=1e-20)
            assert np.linalg.eigvalsh(covariance)[0] > 0


def test_the_pose_covariance_grows_with_every_step() -> None:
    deviations = [
        pose_sigmas(each) for each in run_steps(OdomFrame(), [translation_step(0.02)] * 20)
    ]
    assert np.all(np.diff(deviations, axis=0) > 0)


def test_the_pose_covariance_grows_while_lost_and_shrinks_with_the_next_good_frame() -> None:
    tracker = OdomFrame()
    start = update_frame(tracker, good_estimate(np.eye(4)), 0)
    lost = [update_frame(tracker, failed_estimate(), seq) for seq in range(1, 31)]
    found = update_frame(tracker, good_estimate(np.eye(4)), 31)
    assert np.all(np.diff([pose_sigmas(each) for each in [start, *lost]], axis=0) > 0)
    np.testing.assert_allclose(pose_sigmas(lost[-1]), [0.5] * 3 + [1.0] * 3, rtol=1e-3)
    assert np.all(pose_sigmas(found) < 0.01)


def test_the_covariance_grows_also_before_the_first_good_frame() -> None:
    tracker = OdomFrame()
    lost = [pose_sigmas(update_frame(tracker, failed_estimate(), seq)) for seq in range(31)]
    np.testing.assert_allclose(lost[-1], [0.5] * 3 + [1.0] * 3, rtol=1e-3)


@pytest.mark.slow
def test_the_accumulated_covariance_predicts_the_spread_of_the_pose_errors() -> None:
    random = np.random.default_rng(3)
    step = translation_step(0.1, 0.02) @ rotation_step(yaw_right=0.1)
    covariance = np.diag([1e-3, 5e-4, 2e-3, 1e-3, 2e-3, 5e-4]) ** 2
    covariance[0, 4] = covariance[4, 0] = 0.8e-6
    tracker = OdomFrame(T_BASE_CAMERA_TILTED)
    update_frame(tracker, replace(good_estimate(np.eye(4)), covariance=np.zeros((6, 6))))
    for seq in range(1, 16):
        estimate = replace(
            good_estimate(np.linalg.matrix_power(step, seq), step), covariance=covariance
        )
        predicted = update_frame(tracker, estimate, seq).pose_covariance
    errors = np.array([_odom_error(random, step, covariance, 15) for _ in range(2500)])
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    np.testing.assert_allclose(np.cov(errors.T) / scale, predicted / scale, atol=0.1)


def _odom_error(random: np.random.Generator, step: Array, covariance: Array, count: int) -> Array:
    """Position and small rotation, in odom axes, of one noisy walk's end against the true one."""
    T = np.eye(4)
    for noise in random.multivariate_normal(np.zeros(6), covariance, count):
        T = T @ step @ rigid_transform(so3_exp(noise[3:]), noise[:3])
    ends = (np.linalg.matrix_power(step, count), T)
    truth, found = (T_BASE_CAMERA_TILTED @ each @ inverse(T_BASE_CAMERA_TILTED) for each in ends)
    rotation = so3_log(found[:3, :3] @ truth[:3, :3].T)
    return np.concatenate([found[:3, 3] - truth[:3, 3], rotation])


@pytest.mark.parametrize(
    ("inliers", "state", "reason"),
    [
        (0, TrackingState.TRACKING, ""),  # the first frame of all has nothing to agree with
        (15, TrackingState.DEGRADED, "only 15 of 200 matches agree"),
        (29, TrackingState.DEGRADED, "only 29 of 200 matches agree"),
        (30, TrackingState.TRACKING, ""),
    ],
)
def test_few_inliers_degrade_the_pose(inliers: int, state: TrackingState, reason: str) -> None:
    found = update_frame(OdomFrame(), replace(good_estimate(np.eye(4)), inliers=inliers))
    assert (found.state, found.reason) == (state, reason)


@pytest.mark.parametrize("inliers", [15, 200])
def test_the_reason_of_a_method_has_priority(inliers: int) -> None:
    estimate = replace(good_estimate(np.eye(4)), inliers=inliers, reason="by depth alone")
    found = update_frame(OdomFrame(), estimate)
    assert (found.state, found.reason) == (TrackingState.DEGRADED, "by depth alone")


def test_a_lost_frame_keeps_the_last_pose_and_has_the_reason() -> None:
    tracker = OdomFrame()
    run_steps(tracker, [translation_step(1.0)])
    found = update_frame(tracker, failed_estimate(translation_step(1.0), "lens covered"), 2)
    assert (found.state, found.reason) == (TrackingState.LOST, "lens covered")
    np.testing.assert_allclose(found.T_odom_base[:3, 3], [1.0, 0.0, 0.0], atol=1e-12)


def test_a_restart_starts_an_epoch_with_the_reason_once() -> None:
    tracker = OdomFrame()
    estimates = [
        good_estimate(np.eye(4)),
        replace(good_estimate(np.eye(4)), is_reset=True),
        good_estimate(np.eye(4)),
    ]
    found = [update_frame(tracker, estimate, seq) for seq, estimate in enumerate(estimates)]
    assert [each.epoch for each in found] == [0, 1, 1]
    assert [each.reason for each in found] == ["", "tracking restarted after a loss", ""]


@pytest.mark.parametrize(
    "estimate",
    [good_estimate(np.eye(4)), failed_estimate(), replace(good_estimate(np.eye(4)), inliers=9)],
)
def test_the_reason_of_an_epoch_is_reported_in_any_state(estimate: Estimate) -> None:
    tracker = OdomFrame()
    run_steps(tracker, [translation_step(0.1)] * 5)
    tracker.start_epoch("clock_step")
    assert update_frame(tracker, estimate, 9).reason == "clock_step"
    assert "clock_step" not in update_frame(tracker, estimate, 10).reason


def test_a_new_epoch_starts_with_a_small_covariance_and_unknown_velocity() -> None:
    tracker = OdomFrame()
    before = run_steps(tracker, [translation_step(0.1)] * 30)[-1]
    tracker.start_epoch("clock_step")
    after = update_frame(tracker, good_estimate(translation_step(3.1), translation_step(0.1)), 2)
    assert np.all(pose_sigmas(after) < 0.2 * pose_sigmas(before))
    np.testing.assert_array_equal(after.twist, 0.0)


def test_updates_are_numbered_and_complete() -> None:
    tracker = OdomFrame()
    found = [
        update_frame(tracker, estimate, 5)
        for estimate in (good_estimate(np.eye(4)), failed_estimate(), failed_estimate())
    ]
    assert [each.seq for each in found] == [0, 1, 2]
    assert (found[0].stamp_s, found[0].frame.seq) == (1e9 + 5 / RATE_HZ, 5)
    assert (found[0].stage_ms, found[0].latency_s) == ({"surf": 4.0}, 0.01)


def test_the_twist_covariance_is_that_of_the_step_per_second_in_base_axes() -> None:
    found = run_steps(OdomFrame(), [translation_step(0.1)])[-1].twist_covariance
    turned = np.kron(np.eye(2), R_BODY_OPTICAL)
    np.testing.assert_allclose(found, turned @ STEP_COVARIANCE @ turned.T * RATE_HZ**2, atol=1e-15)

"""A reset places the base where it is told to be, whatever the camera sees just then."""

import numpy as np

from drivers.core.geometry import inverse, rigid_transform, so3_exp
from tests.vo_service.fakes import failed_estimate, good_estimate
from tests.vo_service.odom_frame_steps import (
    T_BASE_CAMERA_TILTED,
    pose_sigmas,
    rotation_step,
    run_steps,
    translation_step,
    update_frame,
)
from vo_service.odom_frame import OdomFrame


def test_a_reset_starts_an_epoch_level_at_the_origin() -> None:
    tracker = OdomFrame(T_BASE_CAMERA_TILTED)
    run_steps(tracker, [translation_step(1.0)] * 3)
    tracker.reset(None)
    found = update_frame(tracker, good_estimate(translation_step(3.0)), 4)
    np.testing.assert_allclose(found.T_odom_base, np.eye(4), atol=1e-12)
    assert (found.epoch, found.reason) == (1, "reset")
    assert np.all(pose_sigmas(found) < 1e-2)


def test_a_reset_to_a_pose_continues_from_there() -> None:
    tracker, there = OdomFrame(T_BASE_CAMERA_TILTED), rigid_transform(so3_exp([0, 0, 1]), [5, 6, 0])
    T = run_steps(tracker, [translation_step(1.0), rotation_step(yaw_right=0.3)])[-1].T_world_camera
    tracker.reset(there)
    step = translation_step(0.4, 0.1) @ rotation_step(0.1, 0.2)
    found = [
        update_frame(tracker, good_estimate(T), 3),
        update_frame(tracker, good_estimate(T @ step, step), 4),
    ]
    np.testing.assert_allclose(found[0].T_odom_base, there, atol=1e-12)
    expected = there @ T_BASE_CAMERA_TILTED @ step @ inverse(T_BASE_CAMERA_TILTED)
    np.testing.assert_allclose(found[1].T_odom_base, expected, atol=1e-12)
    np.testing.assert_array_equal(found[1].T_world_camera, T @ step)  # files know no reset


def test_a_reset_while_lost_sets_the_pose_of_the_next_good_frame() -> None:
    tracker, there = OdomFrame(), rigid_transform(np.eye(3), [5.0, 6.0, 0.0])
    run_steps(tracker, [translation_step(1.0)])
    tracker.reset(there)
    lost = update_frame(tracker, failed_estimate(translation_step(1.0)), 2)
    found = update_frame(tracker, good_estimate(translation_step(1.7), translation_step(0.7)), 3)
    for each in (lost, found):
        np.testing.assert_allclose(each.T_odom_base, there, atol=1e-12)
    assert [lost.epoch, found.epoch] == [1, 1]
    assert np.all(
        pose_sigmas(update_frame(tracker, failed_estimate(translation_step(1.7)), 4))
        > pose_sigmas(found)
    )

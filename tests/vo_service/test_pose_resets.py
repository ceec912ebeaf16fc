"""A reset places the base where it is told to be, whatever the camera sees just then."""

import numpy as np

from drivers.geometry import (
    inverse,
    rigid_transform,
    rotation_from_vector,
)
from tests.vo_service.fakes import bad, good
from tests.vo_service.walking import (
    AWRY,
    motion,
    sigmas,
    turn,
    update,
    walk,
)
from vo_service.pose_tracker import PoseTracker


def test_a_reset_begins_an_epoch_level_at_the_origin() -> None:
    tracker = PoseTracker(AWRY)
    walk(tracker, [motion(1.0)] * 3)
    tracker.reset(None)
    found = update(tracker, good(motion(3.0)), 4)
    np.testing.assert_allclose(found.T_odom_base, np.eye(4), atol=1e-12)
    assert (found.epoch, found.reason) == (1, "reset")
    assert np.all(sigmas(found) < 1e-2)


def test_a_reset_to_a_pose_goes_on_from_there() -> None:
    tracker, there = PoseTracker(AWRY), rigid_transform(rotation_from_vector([0, 0, 1]), [5, 6, 0])
    T = walk(tracker, [motion(1.0), turn(yaw_right=0.3)])[-1].T_world_camera
    tracker.reset(there)
    step = motion(0.4, 0.1) @ turn(0.1, 0.2)
    found = [update(tracker, good(T), 3), update(tracker, good(T @ step, step), 4)]
    np.testing.assert_allclose(found[0].T_odom_base, there, atol=1e-12)
    expected = there @ AWRY @ step @ inverse(AWRY)
    np.testing.assert_allclose(found[1].T_odom_base, expected, atol=1e-12)
    np.testing.assert_array_equal(found[1].T_world_camera, T @ step)  # files know no reset


def test_a_reset_while_lost_says_where_the_camera_is_when_it_sees_again() -> None:
    tracker, there = PoseTracker(), rigid_transform(np.eye(3), [5.0, 6.0, 0.0])
    walk(tracker, [motion(1.0)])
    tracker.reset(there)
    lost = update(tracker, bad(motion(1.0)), 2)
    found = update(tracker, good(motion(1.7), motion(0.7)), 3)
    for each in (lost, found):
        np.testing.assert_allclose(each.T_odom_base, there, atol=1e-12)
    assert [lost.epoch, found.epoch] == [1, 1]
    assert np.all(sigmas(update(tracker, bad(motion(1.7)), 4)) > sigmas(found))

"""The trajectory in memory."""

from dataclasses import replace

import numpy as np

from tests.vo_service.outputs.sample_updates import make_update
from vo_service.outputs.trajectory.trajectory_file import TrajectoryRecorder


def test_only_good_poses_are_recorded() -> None:
    recorder = TrajectoryRecorder()
    updates = [make_update(0), make_update(1, ok=False), make_update(2)]
    for update in updates:
        recorder.on_update(update)
    np.testing.assert_array_equal(
        recorder.trajectory.stamps_s, [updates[0].frame.stamp_s, updates[2].frame.stamp_s]
    )
    np.testing.assert_array_equal(recorder.trajectory.T_world_camera[1], updates[2].T_world_camera)


def test_without_a_pose_the_trajectory_is_empty() -> None:
    trajectory = TrajectoryRecorder().trajectory
    assert (len(trajectory), trajectory.T_world_camera.shape) == (0, (0, 4, 4))


def test_of_poses_with_equal_stamps_the_last_is_kept() -> None:
    recorder = TrajectoryRecorder()
    for seq, number in ((0, 0), (1, 5), (2, 6), (3, 5), (4, 7)):
        frame = replace(make_update(number).frame, stamp_s=float(number))
        recorder.on_update(replace(make_update(seq), frame=frame))
    trajectory = recorder.trajectory
    np.testing.assert_array_equal(trajectory.stamps_s, [0, 5, 6, 7])
    np.testing.assert_array_equal(trajectory.T_world_camera[1], make_update(3).T_world_camera)

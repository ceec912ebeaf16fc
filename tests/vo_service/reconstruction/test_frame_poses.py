"""Each frame gets the pose of its own stamp, and only good poses count."""

import numpy as np
import pytest

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, rigid_transform
from drivers.core.trajectory import Trajectory
from tests.vo_service.reconstruction.scenes import CAMERA, render_wall
from vo_service.reconstruction.frame_poses import FramePoses, TrackedPoseRecorder
from vo_service.types import Estimate, OdometryUpdate, TrackingState


def at(x: float) -> Array:
    return rigid_transform(np.eye(3), [x, 0.0, 0.0])


@pytest.mark.parametrize(
    ("stamp_s", "x"),
    [
        (1.0, 1),
        (1.0199, 1),
        (0.981, 1),
        (1.031, 2),
        (1.025, None),
        (1.05, 2),
        (0.979, None),
        (3.0, None),
    ],
)
def test_the_nearest_pose_within_20_ms_is_used(stamp_s: float, x: float | None) -> None:
    poses = FramePoses(Trajectory(np.array([1.0, 1.05]), np.array([at(1), at(2)])))
    pose = poses.find(stamp_s)
    assert (None if pose is None else pose[0, 3]) == x


def update(stamp_s: float, state: TrackingState, epoch: int = 0) -> OdometryUpdate:
    depth_m, color_bgr = render_wall(2.0)
    raw = (1000 * depth_m).astype(np.uint16)
    frame = RgbdFrame(0, stamp_s, 0.0, color_bgr, raw, 1000.0, CAMERA)
    zero, pose = np.zeros((6, 6)), at(stamp_s)
    estimate = Estimate(state is not TrackingState.LOST, "", pose, np.eye(4), zero)
    return OdometryUpdate(
        0, stamp_s + 1e9, state, "", epoch, pose, pose, pose, zero, np.zeros(6), zero, frame,
        estimate, {}, 0.0,
    )  # fmt: skip


def test_optimized_poses_replace_the_tracked_ones_and_connect_their_epochs() -> None:
    recorder = TrackedPoseRecorder()
    for stamp_s, epoch in enumerate([0, 0, 1, 1, 2]):
        recorder.on_update(update(stamp_s, TrackingState.TRACKING, epoch))
    stamps_s = np.array([0.0, 1.0, 3.0, 4.0, 5.0])  # the pose at 2 is unknown
    corrected = Trajectory(stamps_s, np.array([at(10 * stamp_s) for stamp_s in stamps_s]))
    recorder.apply_correction(corrected, lambda one, other: {one, other} == {0, 1})
    np.testing.assert_array_equal(recorder.longest_trajectory.stamps_s, [0, 1, 3])
    np.testing.assert_array_equal(recorder.longest_trajectory.T_world_camera[:, 0, 3], [0, 10, 30])
    assert (recorder.frame_count, recorder.epoch_count) == (5, 2)


def test_only_tracking_poses_are_recorded_with_the_frame_stamps() -> None:
    recorder = TrackedPoseRecorder()
    states = [TrackingState.TRACKING, TrackingState.DEGRADED, TrackingState.LOST]
    for stamp_s, state in enumerate([*states, TrackingState.TRACKING]):
        recorder.on_update(update(stamp_s, state))
    np.testing.assert_array_equal(recorder.longest_trajectory.stamps_s, [0, 3])
    np.testing.assert_array_equal(recorder.longest_trajectory.T_world_camera[:, 0, 3], [0, 3])
    assert (recorder.frame_count, recorder.epoch_count) == (4, 1)


def test_only_the_longest_epoch_is_used() -> None:
    recorder = TrackedPoseRecorder()
    for stamp_s, epoch in enumerate([0, 0, 1, 1, 1, 2]):
        recorder.on_update(update(stamp_s, TrackingState.TRACKING, epoch))
    np.testing.assert_array_equal(recorder.longest_trajectory.stamps_s, [2, 3, 4])
    assert recorder.epoch_count == 3


def test_without_tracking_there_is_no_pose() -> None:
    recorder = TrackedPoseRecorder()
    recorder.on_update(update(1.0, TrackingState.LOST))
    assert len(recorder.longest_trajectory) == 0
    assert recorder.longest_trajectory.T_world_camera.shape == (0, 4, 4)

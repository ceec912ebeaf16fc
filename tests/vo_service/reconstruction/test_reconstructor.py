"""Frames with poses are fused into a mesh."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.reconstruction import distances_m, make_solids
from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array, Trajectory, rigid_transform, transform_points
from drivers.synthetic.camera import SyntheticCamera
from drivers.synthetic.config import SyntheticConfig
from tests.vo_service.reconstruction.scenes import CAMERA, render_wall
from vo_service.reconstruction.reconstructor import (
    PreviewFrame,
    Reconstructor,
    TrackedPoseRecorder,
)
from vo_service.reconstruction.tsdf_volume import TsdfVolume
from vo_service.reconstruction.voxel_block_grid import TsdfConfig
from vo_service.types.estimate import Estimate
from vo_service.types.odometry_update import OdometryUpdate, TrackingState


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
    poses = Trajectory(np.array([1.0, 1.05]), np.array([at(1), at(2)]))
    pose = poses.pose_near(stamp_s)
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


pytestmark = pytest.mark.slow

# Small, noisy images, far apart along the default motion.
ROOM = SyntheticConfig(
    camera=PinholeCamera(160, 120, 131.0, 131.0, 79.5, 59.5),
    duration_s=3.0,
    rate_hz=4.0,
    texel_m=0.02,
)
SETTINGS = TsdfConfig(voxel_m=0.02, memory_mb=200)
GOOD_M = 0.015


class RecordingPreview:
    """Preview that stores the frames it is shown."""

    def __init__(self) -> None:
        self.shown_frames: list[PreviewFrame] = []

    def show(self, frame: PreviewFrame) -> None:
        self.shown_frames.append(frame)


@pytest.fixture(scope="module")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SyntheticCamera]:
    """A camera that renders once and may be opened repeatedly."""
    camera = SyntheticCamera(ROOM, tmp_path_factory.mktemp("room"))
    yield camera
    camera.close()


@pytest.fixture(scope="module")
def frames(camera: SyntheticCamera) -> list[RgbdFrame]:
    camera.open()
    return list(camera)


@pytest.fixture
def truth(camera: SyntheticCamera) -> Trajectory:
    truth = camera.ground_truth
    assert truth is not None
    return truth


def test_true_surfaces_are_what_the_camera_sees(tmp_path: Path) -> None:
    ideal = replace(
        SyntheticConfig.ideal(), camera=ROOM.camera, duration_s=1.0, rate_hz=1.0, texel_m=0.05
    )
    with SyntheticCamera(ideal, tmp_path) as camera:
        frame, truth = camera.read(60.0), camera.ground_truth
    assert truth is not None
    v, u = np.mgrid[: ROOM.camera.height, : ROOM.camera.width]
    z = frame.depth_m.astype(np.float64)
    x, y = (u - ROOM.camera.cx) / ROOM.camera.fx * z, (v - ROOM.camera.cy) / ROOM.camera.fy * z
    seen_m = transform_points(truth.T_world_camera[0], np.dstack([x, y, z]).reshape(-1, 3)[::7])
    errors_m = distances_m(seen_m, make_solids(ideal))
    assert np.percentile(errors_m, 99) < 0.001  # depth comes in steps of 0.2 mm
    moved_m = seen_m + np.array([0.03, 0.03, 0.05])
    assert np.median(distances_m(moved_m, make_solids(ideal))) > 0.01


def test_with_true_poses_the_mesh_is_on_the_true_surfaces(
    frames: list[RgbdFrame], truth: Trajectory
) -> None:
    reconstruction = Reconstructor(TsdfVolume(SETTINGS), truth)
    for frame in frames:
        reconstruction.add_frame(frame)
    mesh = reconstruction.finish()
    errors_m = distances_m(mesh.vertices_m.astype(np.float64), make_solids(ROOM))
    assert len(errors_m) > 5000
    assert np.median(errors_m) < GOOD_M / 2
    assert np.mean(errors_m < 3 * GOOD_M) > 0.9
    assert reconstruction.result.fused == ROOM.frame_count


def test_frames_without_a_pose_or_depth_are_skipped_and_counted(
    frames: list[RgbdFrame], truth: Trajectory
) -> None:
    first_poses = Trajectory(truth.stamps_s[:4], truth.T_world_camera[:4])
    reconstruction = Reconstructor(TsdfVolume(SETTINGS), first_poses)
    frame_without_depth = replace(frames[1], depth_raw=np.zeros_like(frames[1].depth_raw))
    for frame in (frames[0], frame_without_depth, *frames[2:6]):
        reconstruction.add_frame(frame)
    result = reconstruction.result
    assert (result.frames, result.fused) == (6, 3)
    assert (result.without_pose, result.without_depth, result.full_at_frame) == (2, 1, 0)
    np.testing.assert_array_equal(result.trajectory_m, truth.T_world_camera[[0, 2, 3], :3, 3])
    np.testing.assert_array_equal(result.poses[0], truth.T_world_camera[0])


def test_the_first_frame_after_the_memory_is_full_is_reported(
    frames: list[RgbdFrame], truth: Trajectory
) -> None:
    large = TsdfVolume(SETTINGS)
    needed_mb = []
    for frame, T_world_camera in zip(frames, truth.T_world_camera, strict=True):
        large.integrate(frame.depth_m, frame.color_bgr, frame.camera, T_world_camera)
        needed_mb.append(SETTINGS.memory_mb * large.used_fraction)
    small_config = replace(SETTINGS, memory_mb=round((needed_mb[0] + needed_mb[-1]) / 2))
    reconstruction = Reconstructor(TsdfVolume(small_config), truth)
    for frame in frames:
        reconstruction.add_frame(frame)
    first_too_much = next(n for n, mb in enumerate(needed_mb, 1) if mb > small_config.memory_mb)
    assert reconstruction.result.full_at_frame == first_too_much > 1
    assert len(reconstruction.finish().triangles) > 0


def test_a_preview_gets_each_camera_and_a_new_mesh_only_when_it_has_grown(
    frames: list[RgbdFrame], truth: Trajectory
) -> None:
    preview = RecordingPreview()
    reconstruction = Reconstructor(TsdfVolume(SETTINGS), truth, [preview])
    for frame in [*frames, *frames]:
        reconstruction.add_frame(frame)
    seen = preview.shown_frames[:]
    mesh = reconstruction.finish()
    assert [frame.seq for frame in seen] == [frame.seq for frame in [*frames, *frames]]
    maps = {id(frame.preview_map): frame.preview_map for frame in seen}
    assert 2 <= len(maps) < len(frames)
    sizes = [len(each.mesh.triangles) for each in maps.values()]
    assert sizes == sorted(sizes)
    assert seen[-1].preview_map is seen[len(frames)].preview_map  # nothing new the second time
    assert preview.shown_frames[-1].preview_map.mesh is mesh
    assert len(preview.shown_frames[-1].preview_map.trajectory_m) == 2 * len(frames)

"""Real Rerun recordings, read back."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform, transform_points
from drivers.core.rate_limit import Throttle
from drivers.core.trajectory import Trajectory
from tests.vo_service.outputs.rerun.rerun_recording import (
    count_rows,
    draw,
    is_complete,
    read_column,
)
from vo_service.outputs.rerun.messages import TextLog
from vo_service.outputs.rerun.rrd_file_sink import RrdFileSink
from vo_service.outputs.rerun.scene import back_project
from vo_service.types import OdometryUpdate, Status

pytestmark = pytest.mark.rerun

MakeUpdate = Callable[..., OdometryUpdate]


def record(
    path: Path, updates: list[OdometryUpdate], ground_truth: Trajectory | None = None
) -> None:
    draw(RrdFileSink(path), updates, ground_truth=ground_truth)


@pytest.mark.subprocess
def test_a_recording_is_complete(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    record(path, [make_update(seq) for seq in range(30)])
    assert is_complete(path)
    counted = count_rows(path)
    assert counted["/world/camera"] == 30
    assert counted["/plots/stages/surf"] == 30
    for entity in ("image", "image/features", "image/inliers", "image/outliers", "points"):
        assert counted[f"/world/camera/{entity}"] == 10  # pictures: ten a second of thirty
    assert counted["/depth"] == counted["/world/trajectory/latest"] == 10


def test_poses_and_counts_are_recorded_unchanged(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq) for seq in range(5)]
    record(path, updates)
    positions = read_column(path, "/world/camera", "Transform3D:translation")
    expected = [[u.T_world_camera[:3, 3].tolist()] for u in updates]
    np.testing.assert_allclose(np.array(positions), np.array(expected), atol=1e-6)
    assert read_column(path, "/plots/counts/inliers", "Scalars:scalars") == [[7.0]] * 5


def test_a_long_trajectory_is_not_resent_with_each_point(
    tmp_path: Path, make_update: MakeUpdate
) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq) for seq in range(0, 3 * 250, 3)]
    record(path, updates)
    latest = read_column(path, "/world/trajectory/latest", "LineStrips3D:strips")
    so_far = read_column(path, "/world/trajectory/so_far", "LineStrips3D:strips")
    assert len(latest) == 250
    assert max(len(strips[0]) for strips in latest) == 101  # goes on from the one before
    assert [sum(map(len, strips)) for strips in so_far] == [1, 100, 200]


def test_the_truth_is_aligned_with_the_first_estimate(
    tmp_path: Path, make_update: MakeUpdate
) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq) for seq in range(10)]
    T_truth_world = rigid_transform(np.diag([-1.0, -1.0, 1.0]), [5.0, 6.0, 7.0])
    stamps = np.array([update.stamp_s for update in updates])
    poses = np.array([T_truth_world @ update.T_world_camera for update in updates])
    record(path, updates, Trajectory(stamps, poses))
    (strips,) = read_column(path, "/world/ground_truth", "LineStrips3D:strips")
    expected = [update.T_world_camera[:3, 3] for update in updates]
    np.testing.assert_allclose(np.array(strips)[0], expected, atol=1e-5)


def test_truth_of_another_time_is_not_drawn(tmp_path: Path, make_update: MakeUpdate) -> None:
    path = tmp_path / "out.rrd"
    ground_truth = Trajectory(np.array([1.0, 2.0]), np.array([np.eye(4), np.eye(4)]))
    record(path, [make_update(0)], ground_truth)
    assert count_rows(path)["/world/ground_truth"] == 0


def test_only_changes_of_state_are_recorded(
    tmp_path: Path, make_update: MakeUpdate, status: Status
) -> None:
    path = tmp_path / "out.rrd"
    updates = [make_update(seq, ok=ok) for seq, ok in enumerate([True, True, False, False])]
    draw(RrdFileSink(path), [*updates, status, status, TextLog("paused")])
    assert read_column(path, "/log", "TextLog:text") == [
        ["tracking (epoch 1)"],
        ["lost: too few matches (epoch 1)"],
        ["degraded: few inliers (epoch 1)"],
        ["paused"],
    ]


def test_points_project_to_their_pixels(make_update: MakeUpdate) -> None:
    frame = make_update(0).frame
    points, colors = back_project(frame, grid_px=4)
    pixels = transform_points(rigid_transform(frame.camera.K, np.zeros(3)), points.astype(float))
    pixels = (pixels / pixels[:, 2:])[:, :2]
    np.testing.assert_allclose(pixels, np.round(pixels / 4) * 4, atol=1e-3)
    assert len(points) == 16 * 12 - 4  # the hole in the depth covers four grid points
    assert np.all(points[:, 2] > 0)
    assert len(colors) == len(points)


def test_images_are_rate_limited_also_after_a_clock_step() -> None:
    throttle = Throttle(0.1)
    stamps_s = [0.0, 0.033, 0.066, 0.0999, 0.12, -50.0, -49.99, -49.8]
    assert [throttle.allow(stamp_s) for stamp_s in stamps_s] == [
        True, False, False, True, False, True, False, True,
    ]  # fmt: skip

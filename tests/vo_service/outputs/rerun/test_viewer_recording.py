"""Real Rerun recordings, read back."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import Trajectory, rigid_transform, transform_points
from tests.vo_service.outputs.rerun.rerun_recording import (
    count_rows,
    draw,
    draw_file,
    is_complete,
    read_column,
)
from tests.vo_service.outputs.sample_updates import STATUS, make_update
from tests.vo_service.sample_map import make_map
from vo_service.outputs.rerun.messages import TextLog
from vo_service.outputs.rerun.scene import back_project
from vo_service.outputs.rerun.sinks import RrdFileSink
from vo_service.types.estimate import OnlineTiming
from vo_service.types.occupancy_grid import OCCUPIED, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.rerun


@pytest.mark.subprocess
def test_a_recording_is_complete(tmp_path: Path) -> None:
    path = draw_file(tmp_path, [make_update(seq) for seq in range(30)])
    assert is_complete(path)
    counted = count_rows(path)
    assert counted["/world/camera"] == 30
    assert counted["/plots/stages/surf"] == 30
    for entity in ("image", "image/features", "image/inliers", "image/outliers", "points"):
        assert counted[f"/world/camera/{entity}"] == 10  # pictures: ten a second of thirty
    assert counted["/depth"] == counted["/world/trajectory/latest"] == 10


def test_poses_and_counts_are_recorded_unchanged(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(5)]
    path = draw_file(tmp_path, updates)
    positions = read_column(path, "/world/camera", "Transform3D:translation")
    expected = [[u.T_world_camera[:3, 3].tolist()] for u in updates]
    np.testing.assert_allclose(np.array(positions), np.array(expected), atol=1e-6)
    assert read_column(path, "/plots/counts/inliers", "Scalars:scalars") == [[7.0]] * 5


def test_the_learned_timing_is_plotted_and_its_source_is_logged(tmp_path: Path) -> None:
    usual = OnlineTiming(0.029, 0.0, 0.004, 0.005, "usual for the sensor")
    learned = OnlineTiming(0.0305, -0.0027, 0.0012, 0.0006, "learned")
    timings = [usual, usual, learned, replace(learned, readout_sigma_s=0.001)]
    path = draw_file(
        tmp_path, [with_timing(make_update(seq), timing) for seq, timing in enumerate(timings)]
    )
    plotted = {
        name: [value for (value,) in read_column(path, f"/plots/timing/{name}", "Scalars:scalars")]
        for name in ("readout", "readout_sigma", "depth_offset", "depth_offset_sigma")
    }
    assert plotted["readout"] == pytest.approx([29.0, 30.5, 30.5])
    assert plotted["readout_sigma"] == pytest.approx([4.0, 1.2, 1.0])
    assert plotted["depth_offset"] == pytest.approx([0.0, -2.7, -2.7])
    assert plotted["depth_offset_sigma"] == pytest.approx([5.0, 0.6, 0.6])
    texts = [text for (text,) in read_column(path, "/log", "TextLog:text") if "timing" in text]
    assert texts == [
        "sensor timing: readout 29.0 ± 4.0 ms, depth offset 0.0 ± 5.0 ms (usual for the sensor)",
        "sensor timing: readout 30.5 ± 1.2 ms, depth offset -2.7 ± 0.6 ms (learned)",
    ]


def with_timing(update: OdometryUpdate, timing: OnlineTiming) -> OdometryUpdate:
    """The update of a frame with this timing."""
    return replace(update, estimate=replace(update.estimate, timing=timing))


def test_a_long_trajectory_is_not_resent_with_each_point(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(0, 3 * 250, 3)]
    path = draw_file(tmp_path, updates)
    latest = read_column(path, "/world/trajectory/latest", "LineStrips3D:strips")
    so_far = read_column(path, "/world/trajectory/so_far", "LineStrips3D:strips")
    assert len(latest) == 250
    assert max(len(strips[0]) for strips in latest) == 101  # goes on from the one before
    assert [sum(map(len, strips)) for strips in so_far] == [1, 100, 200]


def test_the_truth_is_aligned_with_the_first_estimate(tmp_path: Path) -> None:
    updates = [make_update(seq) for seq in range(10)]
    T_truth_world = rigid_transform(np.diag([-1.0, -1.0, 1.0]), [5.0, 6.0, 7.0])
    stamps = np.array([update.stamp_s for update in updates])
    poses = np.array([T_truth_world @ update.T_world_camera for update in updates])
    path = draw_file(tmp_path, updates, Trajectory(stamps, poses))
    (strips,) = read_column(path, "/world/ground_truth", "LineStrips3D:strips")
    expected = [update.T_world_camera[:3, 3] for update in updates]
    np.testing.assert_allclose(np.array(strips)[0], expected, atol=1e-5)


def test_truth_of_another_time_is_not_drawn(tmp_path: Path) -> None:
    ground_truth = Trajectory(np.array([1.0, 2.0]), np.array([np.eye(4), np.eye(4)]))
    path = draw_file(tmp_path, [make_update(0)], ground_truth)
    assert count_rows(path)["/world/ground_truth"] == 0


class SmallFile(RrdFileSink):
    """File that is full after its first second."""

    _checks = 0

    def is_full(self) -> bool:
        """Return True once, after thirty results."""
        self._checks += 1
        return self._checks == 30


def test_the_next_file_has_the_map_and_the_grid_too(tmp_path: Path) -> None:
    grid = OccupancyGrid(np.full((1, 1), OCCUPIED, np.int8), 0.1, (1.0, 2.0))
    snapshot = make_map()
    updates = [replace(make_update(seq), map=snapshot, grid=grid) for seq in range(0, 300, 3)]
    draw(SmallFile(tmp_path / "a.rrd"), updates)
    files = sorted(tmp_path.glob("*.rrd"))
    assert len(files) > 1
    for entity in ("/world/map/keyframes", "/world/grid/occupied"):
        assert all(count_rows(file)[entity] == 1 for file in files)


def test_only_changes_of_state_are_recorded(tmp_path: Path) -> None:
    updates = [make_update(seq, ok=ok) for seq, ok in enumerate([True, True, False, False])]
    path = draw_file(tmp_path, [*updates, STATUS, STATUS, TextLog("paused")])
    assert read_column(path, "/log", "TextLog:text") == [
        ["tracking (epoch 1)"],
        ["lost: too few matches (epoch 1)"],
        ["degraded: few inliers (epoch 1)"],
        ["paused"],
    ]


def test_points_project_to_their_pixels() -> None:
    frame = make_update(0).frame
    points, colors = back_project(frame, grid_px=4)
    pixels = transform_points(rigid_transform(frame.camera.K, np.zeros(3)), points.astype(float))
    pixels = (pixels / pixels[:, 2:])[:, :2]
    np.testing.assert_allclose(pixels, np.round(pixels / 4) * 4, atol=1e-3)
    assert len(points) == 16 * 12 - 4  # the hole in the depth covers four grid points
    assert np.all(points[:, 2] > 0)
    assert len(colors) == len(points)

"""Scan and occupancy grid in real Rerun recordings: what is drawn, and where."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.core.geometry import inverse, rigid_transform, so3_exp, transform_points
from tests.vo_service.navigation.views import mounted, update_of, wall_on_floor
from tests.vo_service.outputs.rerun.rerun_recording import count_rows, draw_file, read_column
from vo_service.config_tables import ScanConfig
from vo_service.navigation.frame_scans import FrameScans
from vo_service.types.map_snapshot import MapSnapshot
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED, UNKNOWN, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.rerun

MOUNT = mounted(0.5, 10.0)
SCAN, GRID = "/world/scan", "/world/grid"
POSITIONS = "Points3D:positions"


def grid_at(x_m: float) -> OccupancyGrid:
    """Two occupied cells and a free one."""
    cells = np.array([[OCCUPIED, OCCUPIED, UNKNOWN, FREE]], np.int8)
    return OccupancyGrid(cells, 0.1, (x_m, 2.0))


def robot_updates(count: int, scans: FrameScans) -> list[OdometryUpdate]:
    """Updates at 10 Hz of a robot at the origin, 2 m before a wall."""
    frame = wall_on_floor(MOUNT, 2.0)
    updates = [update_of(frame, MOUNT, 10.0 + 0.1 * seq) for seq in range(count)]
    return [scans.add_to(replace(each, seq=seq)) for seq, each in enumerate(updates)]


def in_odom(points: Sequence[Sequence[float]], update: OdometryUpdate) -> np.ndarray:
    T_odom_world = update.T_odom_camera @ inverse(update.T_world_camera)
    return transform_points(T_odom_world, np.array(points, np.float64))


def test_the_scan_is_drawn_at_the_wall_it_sees(tmp_path: Path) -> None:
    scans = FrameScans(ScanConfig(), MOUNT)
    scans.load()
    updates = robot_updates(3, scans)
    path = draw_file(tmp_path, updates)
    drawn = read_column(path, SCAN, POSITIONS)
    assert len(drawn) == 3
    ends = in_odom(drawn[0], updates[0])
    assert len(ends) > 80
    np.testing.assert_allclose(ends[:, 0], 2.0, atol=0.03)
    np.testing.assert_allclose(ends[:, 2], 0.2, atol=1e-4)
    assert ends[0, 1] < -0.8 < 0.8 < ends[-1, 1]


def test_no_scan_is_drawn_of_a_camera_on_the_floor_or_before_its_kernels_are_loaded(
    tmp_path: Path,
) -> None:
    on_floor = FrameScans(ScanConfig(), mounted(0.0))
    on_floor.load()
    path = draw_file(tmp_path, robot_updates(2, on_floor))
    assert SCAN not in count_rows(path)


def test_the_grid_is_drawn_on_change_where_its_cells_are(tmp_path: Path) -> None:
    scans = FrameScans(ScanConfig(), mounted(0.0))
    first, second = grid_at(1.0), grid_at(3.0)
    grids = [NO_GRID, first, first, second, second, NO_GRID]
    updates = [
        replace(update, grid=grid)
        for update, grid in zip(robot_updates(6, scans), grids, strict=True)
    ]
    path = draw_file(tmp_path, updates)
    occupied = read_column(path, f"{GRID}/occupied", POSITIONS)
    free = read_column(path, f"{GRID}/free", POSITIONS)
    assert [len(points) for points in occupied] == [2, 2, 0]
    assert [len(points) for points in free] == [1, 1, 0]
    np.testing.assert_allclose(occupied[0], [[1.05, 2.05, 0.0], [1.15, 2.05, 0.0]], atol=1e-6)
    np.testing.assert_allclose(free[1], [[3.35, 2.05, 0.0]], atol=1e-6)


def test_the_grid_of_a_loaded_map_moves_to_where_the_robot_finds_itself(tmp_path: Path) -> None:
    grid, T_map_odom = grid_at(1.0), rigid_transform(so3_exp([0.0, 0.0, 1.0]), [5.0, 0.0, 0.0])
    empty = np.empty((0, 4, 4)), np.empty((0, 2), np.int32), np.empty(0, np.bool_)
    lost = MapSnapshot(np.eye(4), *empty, epoch=0, is_localized=False)
    found = MapSnapshot(T_map_odom, *empty, epoch=0)
    updates = robot_updates(3, FrameScans(ScanConfig(), MOUNT))
    snapshots = [lost, found, found]
    updates = [
        replace(each, map=snapshot, grid=grid, epoch=0)
        for each, snapshot in zip(updates, snapshots, strict=True)
    ]
    path = draw_file(tmp_path, updates)
    drawn = read_column(path, f"{GRID}/occupied", POSITIONS)
    assert len(drawn) == 2
    in_map = transform_points(T_map_odom, in_odom(drawn[1], updates[1]))
    np.testing.assert_allclose(in_map, grid.centers_m(OCCUPIED), atol=1e-5)

"""The occupancy grid of walls and tables whose place is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, rigid_transform, so3_exp
from tests.vo_service.navigation.views import frame_of, mounted, rays_in_base, wall_on_floor
from vo_service.config_tables import ScanConfig
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.navigation.grid_rendering import render_grid
from vo_service.navigation.local_grid import CellKind, LocalCells
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED, UNKNOWN, OccupancyGrid

CELL_M = 0.05
quick = settings(max_examples=20, deadline=None)


def mapper_of(T_base_camera: Array, config: ScanConfig = ScanConfig()) -> GridMapper:  # noqa: B008
    return GridMapper(config, T_base_camera, CELL_M, 4.0)


def value_at(grid: OccupancyGrid, x_m: float, y_m: float) -> int:
    column = int(np.floor((x_m - grid.origin_xy_m[0]) / CELL_M))
    row = int(np.floor((y_m - grid.origin_xy_m[1]) / CELL_M))
    height, width = grid.cells.shape
    if not (0 <= row < height and 0 <= column < width):
        return UNKNOWN
    return int(grid.cells[row, column])


def centers(grid: OccupancyGrid, value: int) -> Array:
    """(N, 2) middles of the cells with a value."""
    rows, columns = np.nonzero(grid.cells == value)
    cells = np.stack([columns, rows], axis=1).astype(np.float64)
    middles: Array = (cells + 0.5) * CELL_M + np.array(grid.origin_xy_m)
    return middles


@given(
    st.floats(0.3, 0.6),
    st.floats(0.0, 15.0),
    st.floats(-3.1, 3.1),
    st.floats(-5.0, 5.0),
    st.floats(2.0, 3.0),
)
@quick
def test_a_wall_is_occupied_and_the_floor_before_it_free(
    height_m: float, down_deg: float, yaw: float, x_m: float, wall_m: float
) -> None:
    T_base_camera = mounted(height_m, down_deg)
    T_map_base = rigid_transform(so3_exp([0.0, 0.0, yaw]), (x_m, 1.0, 0.0))
    mapper = mapper_of(T_base_camera)
    cells = mapper.cells(wall_on_floor(T_base_camera, wall_m), T_map_base @ T_base_camera)
    grid = mapper.render([(cells, T_map_base @ T_base_camera)])
    to_base = np.linalg.inv(T_map_base)
    for value, low, high in ((OCCUPIED, wall_m - 0.1, wall_m + 0.1), (FREE, 0.0, wall_m + CELL_M)):
        places = centers(grid, value)
        along = places @ to_base[0, :2] + to_base[0, 3]
        assert len(places) > 10
        assert np.all((along > low) & (along < high))


def table_frame(T_base_camera: Array, high_m: float = 0.7, near_m: float = 1.5) -> Array:
    """Depth of a floor with a table top of 1 m by 1 m."""
    rays, z = rays_in_base(T_base_camera), T_base_camera[2, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        to_floor = np.where(rays[..., 2] < 0, -z / rays[..., 2], np.inf)
        to_top = np.where(rays[..., 2] < 0, (high_m - z) / rays[..., 2], np.inf)
    x, y = to_top * rays[..., 0], to_top * rays[..., 1]
    is_top = (x >= near_m) & (x <= near_m + 1.0) & (np.abs(y) <= 0.5)
    depth = np.where(is_top, to_top, to_floor)
    return np.where(depth < 6.0, depth, 0.0)


def test_a_table_top_is_an_obstacle_that_nothing_erases() -> None:
    """Neither rays over it nor the floor that a low camera sees below it."""
    T = mounted(1.3, 30.0)
    mapper = mapper_of(T)
    seen = mapper.cells(frame_of(table_frame(T)), T), T
    far = rigid_transform(np.eye(3), (-1.2, 0.0, 0.0)) @ T  # its lower rays pass over the top
    over = mapper.cells(frame_of(table_frame(T, near_m=2.7)), far), far
    floor = np.array([(i, j, CellKind.FLOOR) for i in range(20, 60) for j in range(-15, 16)])
    grid = mapper.render([seen, *[over] * 3, *[(floor.astype(np.int16), T)] * 5])
    for x_m in (1.6, 2.0, 2.4):
        for y_m in (-0.4, 0.0, 0.4):
            assert value_at(grid, x_m, y_m) == OCCUPIED


def test_floor_is_free_only_where_no_obstacle_was_ever_marked() -> None:
    floor, mark, look = (np.array([[2, 0, kind]], np.int16) for kind in (2, 1, 0))

    def value(*cells: LocalCells) -> int:
        poses = np.tile([0.02, 0.02, 0.0], (len(cells), 1))
        return value_at(render_grid(cells, poses, CELL_M, 4.0), 0.12, 0.02)

    assert value(floor) == FREE
    assert value(mark) == OCCUPIED
    assert value(mark, floor, floor, floor, floor) == OCCUPIED
    assert value(mark, look, look, look) == FREE
    # Cleared again, but not by enough: floor does not decide.
    assert value(look, look, mark, floor) in (OCCUPIED, UNKNOWN)


def test_what_is_only_looked_over_is_not_free() -> None:
    """Near a high level camera, the lowest ray is far above the floor."""
    T = mounted(1.3)
    mapper = mapper_of(T)
    grid = mapper.render([(mapper.cells(wall_on_floor(T, 3.5), T), T)])
    assert value_at(grid, 1.0, 0.0) == UNKNOWN
    assert value_at(grid, 3.3, 0.0) == FREE


def test_behind_an_obstacle_is_unknown() -> None:
    T = mounted(0.5, 10.0)
    mapper = mapper_of(T)
    grid = mapper.render([(mapper.cells(wall_on_floor(T, 2.0), T), T)])
    assert value_at(grid, 2.5, 0.0) == UNKNOWN


def test_a_camera_on_the_floor_tells_nothing() -> None:
    mapper = mapper_of(mounted(0.0))
    cells = mapper.cells(wall_on_floor(mounted(0.5), 2.0), mounted(0.0))
    assert cells.shape == (0, 3)
    assert mapper.render([(cells, np.eye(4))]) is NO_GRID
    assert mapper.render([]) is NO_GRID


def test_a_camera_of_unknown_height_tells_nothing_when_it_rises() -> None:
    mapper = mapper_of(mounted(0.0))
    risen = mounted(0.5)  # half a meter above where it started, not above the floor
    assert mapper.cells(wall_on_floor(risen, 2.0), risen).shape == (0, 3)


@given(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0))
@quick
def test_the_grid_grows_in_blocks_of_a_meter(x_m: float, y_m: float) -> None:
    T = mounted(0.5, 10.0)
    mapper = mapper_of(T)
    cells = mapper.cells(wall_on_floor(T, 2.0), T)
    there = rigid_transform(np.eye(3), (x_m, y_m, 0.0)) @ T
    for frames in ([(cells, there)], [(cells, T), (cells, there)]):
        grid = mapper.render(frames)
        assert set(np.unique(grid.cells)) <= {FREE, OCCUPIED, UNKNOWN}
        for side in (*grid.cells.shape, *(np.array(grid.origin_xy_m) / CELL_M)):
            assert side == pytest.approx(20 * round(side / 20), abs=1e-6)


def test_a_moved_keyframe_moves_its_cells() -> None:
    """As after a loop closure: nothing is left at the old place."""
    T = mounted(0.5, 10.0)
    mapper = mapper_of(T)
    cells = mapper.cells(wall_on_floor(T, 2.0), T)
    moved = rigid_transform(np.eye(3), (0.0, 10.0, 0.0)) @ T
    before, after = mapper.render([(cells, T)]), mapper.render([(cells, moved)])
    np.testing.assert_array_equal(before.cells, after.cells)
    assert after.origin_xy_m[1] == pytest.approx(before.origin_xy_m[1] + 10.0)
    assert not before.equals(after)
    assert before.equals(mapper.render([(cells, T)]))

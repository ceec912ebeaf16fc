"""The occupancy grid of many frames, from the cells of each at its place in the map.

Nothing but the frames' own cells is kept: after a loop closure all are rendered anew.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.navigation.local_grid import LocalCells
from vo_service.types.occupancy_grid import FREE, NO_GRID, OCCUPIED, UNKNOWN, OccupancyGrid

# Log-odds that a frame adds to a cell, and their limits.
OCCUPIED_LOG_ODDS, FREE_LOG_ODDS = 0.85, -0.4
MIN_LOG_ODDS, MAX_LOG_ODDS = -2.0, 3.5
# Origin and size are multiples of it: each change makes a planner allocate its map anew.
BLOCK_M = 1.0


def render_grid(
    cells: Sequence[LocalCells], poses: Array, resolution_m: float, range_max_m: float
) -> OccupancyGrid:
    """Render the grid.

    Args:
        cells: Cells of each frame.
        poses: (N, 3) x, y (meters) and yaw (radians) of each frame's level frame in the map.
        resolution_m: Side of a cell.
        range_max_m: Largest range of the cells.
    """
    if not cells:
        return NO_GRID
    block_cells = max(1, round(BLOCK_M / resolution_m))
    margin_m = range_max_m + 2.0 * resolution_m
    low, high = poses[:, :2].min(axis=0) - margin_m, poses[:, :2].max(axis=0) + margin_m
    block_m = block_cells * resolution_m
    first = np.floor(low / block_m).astype(np.int64) * block_cells
    blocks = np.ceil(high / block_m).astype(np.int64) * block_cells - first
    log_odds = np.zeros((blocks[1], blocks[0]), np.float32)
    seen = np.zeros((blocks[1], blocks[0]), np.uint8)
    ends = np.cumsum([len(each) for each in cells])
    _add(np.concatenate(cells), ends, poses, resolution_m, first, log_odds, seen)
    return _crop(_classify(log_odds, seen), first, block_cells, resolution_m)


def _classify(log_odds: NDArray[np.float32], seen: NDArray[np.uint8]) -> NDArray[np.int8]:
    """Turn evidence into values. Floor is free only where no obstacle was ever marked above it."""
    values = np.full(log_odds.shape, UNKNOWN, np.int8)
    values[seen == _FLOOR_SEEN] = FREE
    values[log_odds < 0.0] = FREE
    values[log_odds > 0.0] = OCCUPIED
    return values


def _crop(
    values: NDArray[np.int8], first: NDArray[np.int64], block_cells: int, resolution_m: float
) -> OccupancyGrid:
    """Remove unknown blocks at the edges."""
    slices = []
    for axis in (1, 0):  # x, y
        known = np.flatnonzero((values != UNKNOWN).any(axis=1 - axis))
        if not len(known):
            return NO_GRID
        begin = known[0] // block_cells * block_cells
        slices.append(slice(begin, (known[-1] // block_cells + 1) * block_cells))
    x, y = slices
    origin = ((first[0] + x.start) * resolution_m, (first[1] + y.start) * resolution_m)
    return OccupancyGrid(np.ascontiguousarray(values[y, x]), resolution_m, origin)


# Bits of what was seen in a cell.
_FLOOR_SEEN, _OBSTACLE_SEEN = 1, 2


@kernel
def _add(
    cells: LocalCells,
    ends: NDArray[np.int64],
    poses: Array,
    resolution_m: float,
    first: NDArray[np.int64],
    log_odds: NDArray[np.float32],
    seen: NDArray[np.uint8],
) -> None:
    """Add the cells of all frames to the evidence of a map's cells.

    Args:
        cells: Of all frames, one after another.
        ends: (N,) end of each frame's cells.
        first: Column and row of the first cell, counted from the map's origin.
        log_odds: (height, width) zeros.
        seen: (height, width) zeros.
    """
    begin = 0
    for frame in range(ends.size):
        x, y, yaw = poses[frame]
        c, s = np.cos(yaw), np.sin(yaw)
        for number in range(begin, ends[frame]):
            along, left, kind = cells[number]
            column = int(np.floor(x / resolution_m + c * along - s * left)) - first[0]
            row = int(np.floor(y / resolution_m + s * along + c * left)) - first[1]
            if kind == 2:
                seen[row, column] |= _FLOOR_SEEN
                continue
            if kind == 1:
                seen[row, column] |= _OBSTACLE_SEEN
            step = OCCUPIED_LOG_ODDS if kind == 1 else FREE_LOG_ODDS
            total = log_odds[row, column] + step
            log_odds[row, column] = min(max(total, MIN_LOG_ODDS), MAX_LOG_ODDS)
        begin = ends[frame]

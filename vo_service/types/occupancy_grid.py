"""The map of a driving robot: which cells of the floor are free, and which are occupied."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array

# Values of the cells, as ROS has them. Nav2 takes all between for free, so there are no others.
FREE, OCCUPIED, UNKNOWN = 0, 100, -1


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A map of cells. Immutable: a changed map is a new object.

    Attributes:
        cells: (height, width) int8: `FREE`, `OCCUPIED` or `UNKNOWN`; the first row has the least
            y, the first column the least x.
        resolution_m: Side of a cell.
        origin_xy_m: Lower corner of the first cell, in the map.
    """

    cells: NDArray[np.int8] = field(default_factory=lambda: np.empty((0, 0), np.int8))
    resolution_m: float = 0.05
    origin_xy_m: tuple[float, float] = (0.0, 0.0)

    def centers_m(self, value: int) -> Array:
        """(N, 3) middles of the cells with a value, in the map."""
        rows, columns = np.nonzero(self.cells == value)
        cells = np.stack([columns, rows], axis=1).astype(np.float64)
        middles = np.zeros((len(cells), 3))
        middles[:, :2] = (cells + 0.5) * self.resolution_m + np.array(self.origin_xy_m)
        return middles

    def equals(self, other: "OccupancyGrid") -> bool:
        """Whether both have the same cells at the same place."""
        return (
            self.resolution_m == other.resolution_m
            and self.origin_xy_m == other.origin_xy_m
            and np.array_equal(self.cells, other.cells)
        )


NO_GRID = OccupancyGrid()
"""The grid of a service without a map, or before its first keyframe."""

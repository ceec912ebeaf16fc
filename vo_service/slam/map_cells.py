"""The cells of the occupancy grid in a map: those of each frame, at a pose that moves with the map.

A map file may have none: it is of an earlier version, or the map was not localized.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vo_service.navigation.local_grid import LocalCells
from vo_service.slam.pose_graph import AnchoredPose


@dataclass(frozen=True, eq=False)
class FrameCells:
    """The cells of a frame, in its level frame.

    Attributes:
        anchored_pose: Pose of the optical camera.
        cells: (N, 3) int16.
    """

    anchored_pose: AnchoredPose
    cells: LocalCells

    def within(self, radius: float) -> "FrameCells":
        """Return those at most this many cells away."""
        column, row = self.cells[:, 0].astype(np.float64), self.cells[:, 1].astype(np.float64)
        return FrameCells(self.anchored_pose, self.cells[np.hypot(column, row) <= radius])


@dataclass(frozen=True, eq=False)
class MapCells:
    """The cells of a map's frames.

    Attributes:
        resolution_m: Side of a cell.
        frames: In chronological order.
    """

    resolution_m: float
    frames: Sequence[FrameCells]


NO_MAP_CELLS = MapCells(0.0, ())

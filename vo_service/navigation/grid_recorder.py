"""The occupancy grid of a replay: an output that keeps the cells of its keyframes."""

from drivers.core.geometry import Array
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.navigation.local_grid import LocalCells
from vo_service.types.occupancy_grid import OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate, TrackingState
from vo_service.types.outputs import OutputBase

# Every n-th well tracked frame is used.
FRAME_STEP = 3


class GridRecorder(OutputBase):
    """Keeps cells and poses of frames in the state `tracking`, of the last epoch.

    Args:
        mapper: Makes the cells.
    """

    def __init__(self, mapper: GridMapper) -> None:
        self._mapper = mapper
        self._frames: list[tuple[LocalCells, Array]] = []
        self._epoch = 0

    @property
    def frame_count(self) -> int:
        """Number of frames in the grid."""
        return len(self._frames)

    def on_update(self, update: OdometryUpdate) -> None:
        """Add the frame, if it is due."""
        if update.epoch != self._epoch:
            self._frames, self._epoch = [], update.epoch
        if update.state is TrackingState.TRACKING and update.seq % FRAME_STEP == 0:
            cells = self._mapper.cells(update.frame, update.T_odom_camera)
            self._frames.append((cells, update.T_odom_camera))

    def render(self) -> OccupancyGrid:
        """Render the grid, in `odom`."""
        return self._mapper.render(self._frames)

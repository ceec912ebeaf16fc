"""The cells of a configured robot's frames: heights by its mounting, level by its pose."""

from collections.abc import Sequence

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import T_BODY_CAMERA, Array, rigid_transform
from vo_service.config_tables import ScanConfig
from vo_service.navigation.depth_rays import tiny_frame
from vo_service.navigation.grid_rendering import render_grid
from vo_service.navigation.height_limits import height_band
from vo_service.navigation.level_view import LevelMounting
from vo_service.navigation.local_grid import NO_CELLS, LocalCells, local_cells
from vo_service.types.occupancy_grid import OccupancyGrid


class GridMapper:
    """Makes the cells of frames.

    Args:
        config: Heights and the least range.
        T_base_camera: 4x4 pose of the optical camera in the base, which stands on the floor.
        resolution_m: Side of a cell.
        range_max_m: Largest range of a cell.
    """

    def __init__(
        self, config: ScanConfig, T_base_camera: Array, resolution_m: float, range_max_m: float
    ) -> None:
        self._config = config
        self._mounting = LevelMounting(T_base_camera)
        self._resolution_m, self._range_max_m = resolution_m, range_max_m

    @property
    def is_above_floor(self) -> bool:
        """Whether the camera on a level base is higher than the least obstacle."""
        return self._mounting.height_m > self._config.min_height_m

    def cells(self, frame: RgbdFrame, T_odom_camera: Array) -> LocalCells:
        """Return the cells of a frame; none if the camera is not higher than an obstacle.

        Nor are there any for a mounting on the floor: then z of `odom` tells no height.

        Args:
            T_odom_camera: 4x4; it tells what is level. z of `odom` is 0 on the floor.
        """
        view = self._mounting.view(T_odom_camera)
        if not self.is_above_floor or view.height_m <= self._config.min_height_m:
            return NO_CELLS
        band = height_band(self._config, view.height_m, self._range_max_m)
        return local_cells(frame, view, band, self._resolution_m)

    @staticmethod
    def warm_up() -> None:
        """Compile or load the kernels."""
        T_base_camera = rigid_transform(np.eye(3), (0.0, 0.0, 0.5)) @ T_BODY_CAMERA
        mapper = GridMapper(ScanConfig(), T_base_camera, 0.5, 1.0)
        mapper.render([(mapper.cells(tiny_frame(), T_base_camera), T_base_camera)])

    def render(self, frames: Sequence[tuple[LocalCells, Array]]) -> OccupancyGrid:
        """Render the map of frames, given as cells and pose of the optical camera in the map."""
        cells = [each for each, _ in frames]
        poses = np.array([self._mounting.planar_pose(T_map_camera) for _, T_map_camera in frames])
        return render_grid(cells, poses, self._resolution_m, self._range_max_m)

"""The occupancy grid of the mesh keyframes: rendered anew and sent when it has changed."""

import math
import time
from collections.abc import Callable, Iterable

from drivers.core.geometry import Array
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import MapperWorkerConfig, SendMapperMessage
from vo_service.slam.pose_graph import AnchoredPose
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid


class KeyframeGrid:
    """Renders and sends the grid, with a rate limit.

    Args:
        config: Heights, cells and rate.
        send: Sends a message to the service.
    """

    def __init__(self, config: MapperWorkerConfig, send: SendMapperMessage) -> None:
        settings = config.map_config
        self.mapper = GridMapper(
            config.scan_config, config.T_base_camera, settings.resolution_m, settings.range_max_m
        )
        self._send, self._period_s = send, 1.0 / settings.publish_hz
        self._sent, self._sent_s = NO_GRID, -math.inf
        self._is_stale = False

    def mark_stale(self) -> None:
        """The keyframes or their poses may have changed."""
        self._is_stale = True

    def send_if_due(
        self, keyframes: Iterable[MeshKeyframe], T_map_camera: Callable[[AnchoredPose], Array]
    ) -> None:
        """Render the grid and send it, if it has changed and the rate limit allows it."""
        now_s = time.monotonic()
        if not self._is_stale or now_s - self._sent_s < self._period_s:
            return
        self._is_stale, self._sent_s = False, now_s
        grid = self.render(keyframes, T_map_camera)
        if not grid.equals(self._sent):
            self._sent = grid
            self._send(grid)

    def render(
        self, keyframes: Iterable[MeshKeyframe], T_map_camera: Callable[[AnchoredPose], Array]
    ) -> OccupancyGrid:
        """Render the grid of keyframes.

        Args:
            T_map_camera: Returns the 4x4 pose of the optical camera in the map.
        """
        placed = [(each.cells, T_map_camera(each.anchored_pose)) for each in keyframes]
        return self.mapper.render(placed)

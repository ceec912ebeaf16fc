"""From the map of places to what the viewer's process is told of it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import inverse, transform_points
from vo_service.types import NO_MAP, MapSnapshot, PoseUpdate
from vo_service.viewer.messages import Corrected, Graph
from vo_service.viewer.throttle import Throttle

# A map of hours has some ten thousand numbers: more often than this it is not sent.
PERIOD_S = 1.0


class MapSketch:
    """Hangs the map into the world of the first camera, where the odometry's own poses are drawn.

    There it stays, whatever is corrected: so the truth, drawn in the same world, is what the
    corrected places come to lie on, and the odometry's own trajectory what they leave. Only a map
    that `odom` lies nowhere in yet is moved, so that its newest place is where the camera is.
    """

    def __init__(self) -> None:
        self._throttle = Throttle(PERIOD_S)
        self._map: MapSnapshot = NO_MAP
        self._T_world_map = np.eye(4)
        self._is_hung = False
        self._is_told = True
        self.graph = Graph()

    def see(self, update: PoseUpdate) -> None:
        """Take the map of one result."""
        if update.map is self._map or not update.estimate.ok:
            return
        self._map, self._is_told = update.map, False
        if not self._is_hung:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            self._T_world_map = update.T_world_camera @ inverse(T_map_camera)
            self._is_hung = update.is_located
        self.graph = self._graph()

    def of_time(self, now_s: float) -> Iterator[Graph]:
        """The map, if it is another than the one that was told and it is time."""
        if not self._is_told and self._throttle.due(now_s):
            yield from self.rest()

    def rest(self) -> Iterator[Graph]:
        """The map, if it is another than the one that was told."""
        if not self._is_told:
            self._is_told = True
            yield self.graph

    def corrected(self, update: PoseUpdate) -> Iterator[Corrected]:
        """Where the camera is in the map, if there is one that knows of its epoch."""
        if self._map is not NO_MAP and self._map.epoch == update.epoch:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            yield Corrected((self._T_world_map @ T_map_camera)[:3, 3])

    def _graph(self) -> Graph:
        found = self._map
        in_world = transform_points(self._T_world_map, found.T_map_place[:, :3, 3])
        positions: NDArray[np.float32] = in_world.astype(np.float32)
        lines = positions[found.edges]
        return Graph(positions, lines[~found.is_loop], lines[found.is_loop])

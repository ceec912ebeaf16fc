"""From the map of places to what the viewer's process is told of it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import inverse, transform_points
from drivers.core.rate_limit import Throttle
from vo_service.outputs.rerun.messages import CorrectedPosition, MapGraph
from vo_service.types import NO_MAP, MapSnapshot, OdometryUpdate

# A map of hours has some ten thousand numbers: more often than this it is not sent.
MIN_PERIOD_S = 1.0


class MapEncoder:
    """Hangs the map into the world of the first camera, where the odometry's own poses are drawn.

    There it stays, whatever is corrected: so the truth, drawn in the same world, is what the
    corrected places come to lie on, and the odometry's own trajectory what they leave. Only a map
    that `odom` lies nowhere in yet is moved, so that its newest place is where the camera is.
    """

    def __init__(self) -> None:
        self._throttle = Throttle(MIN_PERIOD_S)
        self._map: MapSnapshot = NO_MAP
        self._T_world_map = np.eye(4)
        self._is_anchored = False
        self._is_sent = True
        self.graph = MapGraph()

    def update(self, update: OdometryUpdate) -> None:
        """Take the map of one result."""
        if update.map is self._map or not update.estimate.ok:
            return
        self._map, self._is_sent = update.map, False
        if not self._is_anchored:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            self._T_world_map = update.T_world_camera @ inverse(T_map_camera)
            self._is_anchored = update.is_localized
        self.graph = self._build_graph()

    def encode_if_due(self, now_s: float) -> Iterator[MapGraph]:
        """The map, if it is another than the one that was told and it is time."""
        if not self._is_sent and self._throttle.allow(now_s):
            yield from self.encode_pending()

    def encode_pending(self) -> Iterator[MapGraph]:
        """The map, if it is another than the one that was told."""
        if not self._is_sent:
            self._is_sent = True
            yield self.graph

    def encode_corrected_position(self, update: OdometryUpdate) -> Iterator[CorrectedPosition]:
        """Where the camera is in the map, if there is one that knows of its epoch."""
        if self._map is not NO_MAP and self._map.epoch == update.epoch:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            yield CorrectedPosition((self._T_world_map @ T_map_camera)[:3, 3])

    def _build_graph(self) -> MapGraph:
        found = self._map
        in_world = transform_points(self._T_world_map, found.T_map_keyframe[:, :3, 3])
        positions: NDArray[np.float32] = in_world.astype(np.float32)
        lines = positions[found.edges]
        return MapGraph(positions, lines[~found.is_loop_closure], lines[found.is_loop_closure])

"""Encoder of the keyframe map for the viewer's process."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import inverse, transform_points
from drivers.core.rate_limit import Throttle
from vo_service.outputs.rerun.messages import CorrectedPosition, MapGraph
from vo_service.types import NO_MAP, MapSnapshot, OdometryUpdate

# A map of hours has tens of thousands of numbers, so it is sent at most this often.
MIN_PERIOD_S = 1.0


class MapEncoder:
    """Places the map in the world of the first camera, where the odometry's poses are drawn.

    The transform from map to world stays fixed while the map is corrected. Corrected keyframes thus
    move onto the ground truth and away from the odometry's trajectory. Until the camera is
    localized, the transform follows the camera's pose.
    """

    def __init__(self) -> None:
        self._throttle = Throttle(MIN_PERIOD_S)
        self._map: MapSnapshot = NO_MAP
        self._T_world_map = np.eye(4)
        self._is_anchored = False
        self._is_sent = True
        self.graph = MapGraph()

    def update(self, update: OdometryUpdate) -> None:
        """Take over the map of one result."""
        if update.map is self._map or not update.estimate.ok:
            return
        self._map, self._is_sent = update.map, False
        if not self._is_anchored:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            self._T_world_map = update.T_world_camera @ inverse(T_map_camera)
            self._is_anchored = update.is_localized
        self.graph = self._build_graph()

    def encode_if_due(self, now_s: float) -> Iterator[MapGraph]:
        """Yield the map if it has changed since it was sent and the period has passed."""
        if not self._is_sent and self._throttle.allow(now_s):
            yield from self.encode_pending()

    def encode_pending(self) -> Iterator[MapGraph]:
        """Yield the map if it has changed since it was sent."""
        if not self._is_sent:
            self._is_sent = True
            yield self.graph

    def encode_corrected_position(self, update: OdometryUpdate) -> Iterator[CorrectedPosition]:
        """Yield the camera's position in the map, if the map is of the same epoch."""
        if self._map is not NO_MAP and self._map.epoch == update.epoch:
            T_map_camera = self._map.T_map_odom @ update.T_odom_camera
            yield CorrectedPosition((self._T_world_map @ T_map_camera)[:3, 3])

    def _build_graph(self) -> MapGraph:
        snapshot = self._map
        in_world = transform_points(self._T_world_map, snapshot.T_map_keyframe[:, :3, 3])
        positions: NDArray[np.float32] = in_world.astype(np.float32)
        lines = positions[snapshot.edges]
        is_loop = snapshot.is_loop_closure
        return MapGraph(positions, lines[~is_loop], lines[is_loop])

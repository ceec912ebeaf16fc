"""The occupancy grid of the mesh keyframes and of a loaded map: sent anew when it has changed."""

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from drivers.core.geometry import Array
from vo_service.navigation.grid_mapper import GridMapper
from vo_service.slam.keyframe_selection import pose_distance_steps
from vo_service.slam.map_cells import FrameCells, MapCells
from vo_service.slam.mapper.mesh_keyframes import MeshKeyframe
from vo_service.slam.mapper.messages import MapperWorkerConfig, SendMapperMessage
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid


class KeyframeMap(Protocol):
    """The map that poses of keyframes are relative to."""

    @property
    def is_localized(self) -> bool:
        """Whether the keyframes' poses in the map are known."""
        ...

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """4x4 pose of the optical camera in the map."""
        ...


class KeyframeGrid:
    """Renders and sends the grid, with a rate limit.

    Args:
        config: Heights, cells and rate.
        send: Sends a message to the service.
    """

    def __init__(self, config: MapperWorkerConfig, send: SendMapperMessage) -> None:
        self._settings = settings = config.map_config
        self.mapper = GridMapper(
            config.scan_config, config.T_base_camera, settings.resolution_m, settings.range_max_m
        )
        self._send, self._period_s = send, 1.0 / settings.publish_hz
        self._sent, self._sent_s = NO_GRID, -math.inf
        self._is_stale = False
        self._loaded: Sequence[FrameCells] = ()

    def mark_stale(self) -> None:
        """The keyframes or their poses may have changed."""
        self._is_stale = True

    def load(self, cells: MapCells) -> str:
        """Replace the cells of the loaded map.

        Returns:
            Why there are none; "" if there are, and for a camera that gives none.
        """
        self._is_stale, self._loaded = True, ()
        resolution_m, range_max_m = self._settings.resolution_m, self._settings.range_max_m
        if not self.mapper.is_above_floor:
            return ""
        if not cells.frames:
            return "it has no cells of the occupancy grid"
        if cells.resolution_m != resolution_m:
            return f"its cells are those of map.resolution_m = {cells.resolution_m:g}"
        # `render` has room for no others.
        self._loaded = [each.within(range_max_m / resolution_m + 1.0) for each in cells.frames]
        return ""

    def re_anchor(self, removal: NodeRemoval) -> None:
        """Re-anchor the loaded cells after the removal of a map keyframe."""
        self._loaded = [
            replace(each, anchored_pose=each.anchored_pose.re_anchor(removal))
            for each in self._loaded
        ]

    def contents(self, keyframes: Iterable[MeshKeyframe], the_map: KeyframeMap) -> MapCells:
        """Return the cells to be saved: new ones replace those that were loaded for a place."""
        new = [FrameCells(each.anchored_pose, each.cells) for each in keyframes if len(each.cells)]
        if not new or not the_map.is_localized:
            return MapCells(self._settings.resolution_m, self._loaded)
        poses = np.array([the_map.T_map_camera(each.anchored_pose) for each in new])
        old = [
            each
            for each in self._loaded
            if pose_distance_steps(the_map.T_map_camera(each.anchored_pose), poses).min() >= 1.0
        ]
        return MapCells(self._settings.resolution_m, [*old, *new])

    def send_if_due(self, keyframes: Iterable[MeshKeyframe], the_map: KeyframeMap) -> None:
        """Render the grid and send it, if it has changed and the rate limit allows it."""
        now_s = time.monotonic()
        if not self._is_stale or now_s - self._sent_s < self._period_s:
            return
        self._is_stale, self._sent_s = False, now_s
        grid = self.render(keyframes, the_map)
        if not grid.equals(self._sent):
            self._sent = grid
            self._send(grid)

    def render(self, keyframes: Iterable[MeshKeyframe], the_map: KeyframeMap) -> OccupancyGrid:
        """Render the grid; that of a loaded map alone until the robot is localized in it."""
        frames = [(each.cells, each.anchored_pose) for each in self._loaded]
        if the_map.is_localized or not frames:
            frames += [(each.cells, each.anchored_pose) for each in keyframes]
        return self.mapper.render([(cells, the_map.T_map_camera(pose)) for cells, pose in frames])

"""Where a camera was, as seen from a place: it moves along when the map is corrected."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.geometry import Array

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.pose_graph.pose_graph import NodeRemoval


@dataclass(frozen=True, eq=False)
class AnchoredPose:
    """A pose of the camera.

    place           number of the last place before it; None where there is none
    T_place_camera  4x4, from there; from the map where there is none
    """

    keyframe_number: int | None
    T_keyframe_camera: Array

    def re_anchor(self, removal: "NodeRemoval") -> "AnchoredPose":
        """The same when a place is no more: its own is told from a neighbour of that."""
        if self.keyframe_number != removal.number:
            return self
        return AnchoredPose(removal.neighbor, removal.T_neighbor_removed @ self.T_keyframe_camera)

    def to_map(self, T_map_keyframe: Callable[[int], Array]) -> Array:
        """4x4 T_map_camera, the places being where `T_map_keyframe` says."""
        if self.keyframe_number is None:
            return self.T_keyframe_camera
        return np.asarray(T_map_keyframe(self.keyframe_number) @ self.T_keyframe_camera)

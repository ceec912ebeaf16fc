"""A pose relative to a keyframe: it moves with the keyframe when the map is optimized."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.geometry import Array

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.pose_graph.pose_graph import NodeRemoval


@dataclass(frozen=True, eq=False)
class AnchoredPose:
    """A pose of the camera relative to a keyframe.

    Attributes:
        keyframe_number: Number of the last keyframe before it; None if there is none.
        T_keyframe_camera: 4x4 relative to the keyframe, or to the map if there is none.
    """

    keyframe_number: int | None
    T_keyframe_camera: Array

    def re_anchor(self, removal: "NodeRemoval") -> "AnchoredPose":
        """Return the pose relative to the neighbor, if its keyframe is the removed one."""
        if self.keyframe_number != removal.number:
            return self
        return AnchoredPose(removal.neighbor, removal.T_neighbor_removed @ self.T_keyframe_camera)

    def to_map(self, T_map_keyframe: Callable[[int], Array]) -> Array:
        """4x4 T_map_camera, with the keyframes' poses by `T_map_keyframe`."""
        if self.keyframe_number is None:
            return self.T_keyframe_camera
        return np.asarray(T_map_keyframe(self.keyframe_number) @ self.T_keyframe_camera)

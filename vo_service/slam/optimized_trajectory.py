"""Poses relative to keyframes: they move with the keyframes when the map is optimized."""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.geometry import Array, Trajectory, inverse

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.slam.pose_graph import NodeRemoval, PoseGraph


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


class OptimizedTrajectory:
    """Trajectory whose poses are anchored to keyframes and move with them."""

    def __init__(self, graph: "PoseGraph") -> None:
        self._graph = graph
        self._poses: dict[float, AnchoredPose] = {}  # by stamp
        self._stamps_s_by_keyframe: defaultdict[int | None, list[float]] = defaultdict(list)

    def add(self, stamp_s: float, keyframe_number: int, T_keyframe_camera: Array) -> None:
        """Add a frame; it replaces one with the same stamp.

        Args:
            stamp_s: Stamp of the frame, s.
            keyframe_number: Number of the last keyframe.
            T_keyframe_camera: 4x4 pose of the optical camera relative to it, m.
        """
        self._poses[stamp_s] = AnchoredPose(keyframe_number, T_keyframe_camera)
        self._stamps_s_by_keyframe[keyframe_number].append(stamp_s)

    def re_anchor(self, removal: "NodeRemoval") -> None:
        """Anchor the poses of a removed keyframe to its neighbor."""
        stamps_s = self._stamps_s_by_keyframe.pop(removal.number, [])
        for stamp_s in stamps_s:
            self._poses[stamp_s] = self._poses[stamp_s].re_anchor(removal)
        self._stamps_s_by_keyframe[removal.neighbor] += stamps_s

    @property
    def trajectory(self) -> Trajectory:
        """Poses by ascending stamps; the first one is the identity."""
        stamps_s = sorted(self._poses)
        poses = np.array(
            [self._poses[stamp_s].to_map(self._graph.T_map_keyframe) for stamp_s in stamps_s]
        )
        if len(poses):
            poses = inverse(poses[0]) @ poses
        return Trajectory(np.array(stamps_s), poses.reshape(-1, 4, 4))

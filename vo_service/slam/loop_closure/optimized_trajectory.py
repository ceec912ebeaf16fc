"""The whole trajectory, by the final map."""

from collections import defaultdict

import numpy as np

from drivers.core.geometry import Array, inverse
from drivers.core.trajectory import Trajectory
from vo_service.slam.loop_closure.anchored_pose import AnchoredPose
from vo_service.slam.pose_graph.pose_graph import NodeRemoval, PoseGraph


class OptimizedTrajectory:
    """Trajectory whose poses are anchored to keyframes and move with them."""

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._poses: dict[float, AnchoredPose] = {}  # by stamp
        self._stamps_s_by_keyframe: defaultdict[int | None, list[float]] = defaultdict(list)

    def add(self, stamp_s: float, keyframe_number: int, T_keyframe_camera: Array) -> None:
        """Add a frame; it replaces one with the same stamp."""
        self._poses[stamp_s] = AnchoredPose(keyframe_number, T_keyframe_camera)
        self._stamps_s_by_keyframe[keyframe_number].append(stamp_s)

    def re_anchor(self, removal: NodeRemoval) -> None:
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

"""The whole trajectory, corrected by what was known in the end."""

import numpy as np

from drivers.geometry import Array, inverse
from drivers.trajectory import StampedPoses
from vo_service.mapping.graph.pose_graph import PoseGraph, Removal
from vo_service.mapping.loops.from_place import FromPlace


class CorrectedTrajectory:
    """Remembers each frame from the place before it, so that it moves along when that does."""

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._poses: list[tuple[float, FromPlace]] = []  # with their stamps

    def add(self, stamp_s: float, place: int, T_place_camera: Array) -> None:
        """Remember a frame."""
        self._poses.append((stamp_s, FromPlace(place, T_place_camera)))

    def carry_over(self, removal: Removal) -> None:
        """The same poses, from the neighbour of a place that is no more."""
        self._poses = [(stamp_s, pose.carried_over(removal)) for stamp_s, pose in self._poses]

    @property
    def trajectory(self) -> StampedPoses:
        """By rising stamps, from the first pose on: of poses that went back in time, the last."""
        by_stamp = dict(self._poses)
        stamps_s = sorted(by_stamp)
        poses = np.array([by_stamp[stamp_s].in_map(self._graph.T_map) for stamp_s in stamps_s])
        if len(poses):
            poses = inverse(poses[0]) @ poses
        return StampedPoses(np.array(stamps_s), poses.reshape(-1, 4, 4))

"""The whole trajectory, corrected by what was known in the end."""

from collections import defaultdict

import numpy as np

from drivers.geometry import Array, inverse
from drivers.trajectory import StampedPoses
from vo_service.mapping.graph.pose_graph import PoseGraph, Removal
from vo_service.mapping.loops.from_place import FromPlace


class CorrectedTrajectory:
    """Remembers each frame from the place before it, so that it moves along when that does."""

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._poses: dict[float, FromPlace] = {}  # by their stamps
        self._stamps_s: defaultdict[int | None, list[float]] = defaultdict(list)  # by their places

    def add(self, stamp_s: float, place: int, T_place_camera: Array) -> None:
        """Remember a frame; of frames with one stamp the last."""
        self._poses[stamp_s] = FromPlace(place, T_place_camera)
        self._stamps_s[place].append(stamp_s)

    def carry_over(self, removal: Removal) -> None:
        """The same poses, from the neighbour of a place that is no more."""
        stamps_s = self._stamps_s.pop(removal.number, [])
        for stamp_s in stamps_s:
            self._poses[stamp_s] = self._poses[stamp_s].carried_over(removal)
        self._stamps_s[removal.neighbour] += stamps_s

    @property
    def trajectory(self) -> StampedPoses:
        """By rising stamps, from the first pose on."""
        stamps_s = sorted(self._poses)
        poses = np.array([self._poses[stamp_s].in_map(self._graph.T_map) for stamp_s in stamps_s])
        if len(poses):
            poses = inverse(poses[0]) @ poses
        return StampedPoses(np.array(stamps_s), poses.reshape(-1, 4, 4))

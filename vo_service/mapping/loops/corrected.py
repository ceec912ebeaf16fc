"""The whole trajectory, corrected by what was known in the end."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.geometry import Array, inverse
from drivers.trajectory import StampedPoses
from vo_service.mapping.graph.pose_graph import PoseGraph, Removal


@dataclass(frozen=True)
class _Pose:
    """A frame's pose from the last place before it: 4x4; from the map where there is none."""

    stamp_s: float
    place: int | None
    T_place_camera: Array


class CorrectedTrajectory:
    """Remembers each frame from the place before it, so that it moves along when that does."""

    def __init__(self, graph: PoseGraph) -> None:
        self._graph = graph
        self._poses: list[_Pose] = []

    def add(self, stamp_s: float, place: int, T_place_camera: Array) -> None:
        """Remember a frame."""
        self._poses.append(_Pose(stamp_s, place, T_place_camera))

    def carry_over(self, removal: Removal) -> None:
        """The same poses, from the neighbour of a place that is no more."""
        for index, pose in enumerate(self._poses):
            if pose.place == removal.number:
                T = removal.T_neighbour_removed @ pose.T_place_camera
                self._poses[index] = replace(pose, place=removal.neighbour, T_place_camera=T)

    @property
    def trajectory(self) -> StampedPoses:
        """By rising stamps, from the first pose on: of poses that went back in time, the last."""
        by_stamp = {pose.stamp_s: pose for pose in self._poses}
        ordered = [by_stamp[stamp_s] for stamp_s in sorted(by_stamp)]
        poses = np.array([self._T_map(p.place) @ p.T_place_camera for p in ordered])
        if len(poses):
            poses = inverse(poses[0]) @ poses
        return StampedPoses(np.array([p.stamp_s for p in ordered]), poses.reshape(-1, 4, 4))

    def _T_map(self, place: int | None) -> Array:
        return np.eye(4) if place is None else self._graph.T_map(place)

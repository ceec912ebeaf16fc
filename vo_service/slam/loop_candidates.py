"""Candidates for a loop closure: the most similar keyframes and those nearby."""

from collections import deque

import numpy as np

from drivers.core.geometry import Array
from vo_service.slam.keyframe_database import KeyframeDatabase, MapKeyframe, QueryFrame
from vo_service.slam.keyframe_selection import pose_distance_steps
from vo_service.slam.pose_graph import PoseGraph

# The last keyframes are no loop candidates: the odometry itself was aligned with them.
MAX_RECENT_KEYFRAMES = 8
# Number of candidates: the most similar ones, and those nearest to the camera's expected pose.
MAX_SIMILAR_KEYFRAMES, MAX_NEARBY_KEYFRAMES = 5, 2
# Largest distance of a nearby keyframe.
MAX_NEARBY_STEPS = 4.0


class LoopCandidates:
    """Selection of loop candidates from the database."""

    def __init__(self, database: KeyframeDatabase, graph: PoseGraph) -> None:
        self._database = database
        self._graph = graph
        self._recent: deque[int] = deque(maxlen=MAX_RECENT_KEYFRAMES)
        self._world_id: int | None = None

    def mark_visited(self, keyframe: MapKeyframe) -> None:
        """Mark a keyframe as recently visited."""
        self._recent.append(keyframe.number)

    def find_similar(self, query: QueryFrame) -> list[MapKeyframe]:
        """Find keyframes that look like a view, the most similar first."""
        return self._database.find_similar(query, MAX_SIMILAR_KEYFRAMES, lambda keyframe: True)

    def find_loop_candidates(
        self, query: QueryFrame, world_id: int, T_map_camera: Array
    ) -> list[MapKeyframe]:
        """Find loop candidates of a view in a world frame, at its pose in the map.

        Args:
            world_id: Number of its world frame.
            T_map_camera: 4x4 pose of the optical camera in the map, m.
        """
        if world_id != self._world_id:
            self._world_id = world_id
            self._recent.clear()
        similar = self._database.find_similar(query, MAX_SIMILAR_KEYFRAMES, self._is_not_recent)
        numbers = {keyframe.number for keyframe in similar}
        return similar + [
            each for each in self._find_nearby(T_map_camera) if each.number not in numbers
        ]

    def _find_nearby(self, T_map_camera: Array) -> list[MapKeyframe]:
        old = [keyframe for keyframe in self._database if self._is_not_recent(keyframe)]
        if not old:
            return []
        T_map_keyframes = np.array(
            [self._graph.T_map_keyframe(keyframe.number) for keyframe in old]
        )
        steps = pose_distance_steps(T_map_camera, T_map_keyframes)
        nearest = np.argsort(steps, kind="stable")[:MAX_NEARBY_KEYFRAMES]
        return [old[index] for index in nearest if steps[index] <= MAX_NEARBY_STEPS]

    def _is_not_recent(self, keyframe: MapKeyframe) -> bool:
        return keyframe.number not in self._recent

"""Which places a new view may show: those that look like it, and those that should be there."""

from collections import deque

import numpy as np

from drivers.core.geometry import Array
from vo_service.slam.keyframe_selector import pose_distance_steps
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.query_frame import QueryFrame
from vo_service.slam.pose_graph.pose_graph import PoseGraph

# The last places of the way are no loop: the odometry was laid on them itself.
MAX_RECENT_KEYFRAMES = 8
# So many places are looked at closely: those that look most alike, and those nearest to where the
# camera should be.
MAX_SIMILAR_KEYFRAMES, MAX_NEARBY_KEYFRAMES = 5, 2
# A place should be in view from so many steps away.
MAX_NEARBY_STEPS = 4.0


class LoopCandidates:
    """Chooses among places."""

    def __init__(self, database: KeyframeDatabase, graph: PoseGraph) -> None:
        self._database = database
        self._graph = graph
        self._recent: deque[int] = deque(maxlen=MAX_RECENT_KEYFRAMES)
        self._world_id: int | None = None  # of these

    def mark_visited(self, keyframe: MapKeyframe) -> None:
        """The camera has come by this place."""
        self._recent.append(keyframe.number)

    def find_similar(self, query: QueryFrame) -> list[MapKeyframe]:
        """Those that look like a view, the most alike first."""
        return self._database.find_similar(query, MAX_SIMILAR_KEYFRAMES, lambda place: True)

    def find_loop_candidates(
        self, query: QueryFrame, world_id: int, T_map_camera: Array
    ) -> list[MapKeyframe]:
        """Those that would be a loop, for a view in a world, from where the graph has it."""
        if world_id != self._world_id:
            self._world_id = world_id
            self._recent.clear()
        found = self._database.find_similar(query, MAX_SIMILAR_KEYFRAMES, self._is_not_recent)
        known = {place.number for place in found}
        return found + [
            each for each in self._find_nearby(T_map_camera) if each.number not in known
        ]

    def _find_nearby(self, T_map_camera: Array) -> list[MapKeyframe]:
        old = [place for place in self._database if self._is_not_recent(place)]
        if not old:
            return []
        T_map_places = np.array([self._graph.T_map_keyframe(place.number) for place in old])
        steps = pose_distance_steps(T_map_camera, T_map_places)
        nearest = np.argsort(steps, kind="stable")[:MAX_NEARBY_KEYFRAMES]
        return [old[index] for index in nearest if steps[index] <= MAX_NEARBY_STEPS]

    def _is_not_recent(self, keyframe: MapKeyframe) -> bool:
        return keyframe.number not in self._recent

"""Selection of loops: candidates for a view, merging of world frames, and when to optimize."""

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, poses_close
from vo_service.slam.graph_edges import Edge
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
            query: The view.
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


# Largest difference of two loops that agree on the relative pose of two world frames.
MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD = 0.10, 0.05


@dataclass(frozen=True, eq=False)
class _MergeHypothesis:
    """A loop between two world frames, and their relative pose by it."""

    loop: Edge
    world_ids: tuple[int, int]
    T_old_new: Array


class MapMerger:
    """Merge two world frames once two loops agree on their relative pose."""

    def __init__(self) -> None:
        self._pending_hypotheses: list[_MergeHypothesis] = []

    def add_loop(self, loop: Edge, old: MapKeyframe, new: MapKeyframe) -> list[Edge]:
        """Add a loop between two world frames.

        Args:
            loop: From the old keyframe to the new one.
            old: The old keyframe.
            new: The new keyframe.

        Returns:
            The loops to close: none, or this one and the pending ones that agree with it.
        """
        T_old_new = old.T_world_keyframe @ loop.T_a_b @ inverse(new.T_world_keyframe)
        hypothesis = _MergeHypothesis(loop, (old.world_id, new.world_id), T_old_new)
        others = [
            each for each in self._pending_hypotheses if each.world_ids == hypothesis.world_ids
        ]
        agreed = [
            each
            for each in others
            if poses_close(each.T_old_new, T_old_new, MAX_DISAGREEMENT_M, MAX_DISAGREEMENT_RAD)
        ]
        resolved = others if agreed else []
        self._pending_hypotheses = [
            each for each in self._pending_hypotheses if each not in resolved
        ]
        if agreed:
            return [*(each.loop for each in agreed), loop]
        self._pending_hypotheses.append(hypothesis)
        return []


# Consistent loops are optimized after this many keyframes.
MAX_PENDING_KEYFRAMES = 10
# Smallest number of keyframes between two optimizations, as a share of all keyframes: so the cost
# per keyframe does not grow with the map.
MIN_INTERVAL_RATIO = 0.01


class OptimizationSchedule:
    """Count keyframes and optimizations."""

    def __init__(self) -> None:
        self._pending_keyframes = 0  # since the first loop that is not optimized yet
        self._keyframes_since_optimization = math.inf
        self._is_inconsistent = False

    @property
    def has_pending_loops(self) -> bool:
        """Whether there are loops that are not optimized yet."""
        return self._pending_keyframes > 0

    def add_keyframe(self, keyframe_count: int, *, has_loops: bool, is_inconsistent: bool) -> bool:
        """Add a keyframe; return whether to optimize now.

        Args:
            keyframe_count: Number of keyframes in the map.
            has_loops: Whether the keyframe has loops.
            is_inconsistent: Whether these differ from the map.
        """
        self._keyframes_since_optimization += 1
        self._pending_keyframes += has_loops or self.has_pending_loops
        self._is_inconsistent |= is_inconsistent
        is_due = self._is_inconsistent or self._pending_keyframes > MAX_PENDING_KEYFRAMES
        return is_due and self._keyframes_since_optimization >= MIN_INTERVAL_RATIO * keyframe_count

    def mark_optimized(self) -> None:
        """Mark all loops as optimized."""
        self._pending_keyframes, self._keyframes_since_optimization = 0, 0
        self._is_inconsistent = False

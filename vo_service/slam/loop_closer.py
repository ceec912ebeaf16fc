"""Loop closer: each keyframe is compared with older ones, and loops optimize the pose graph.

Pose graphs as in Kuemmerle et al., "g2o" (ICRA 2011); views are described as in Jegou et al.,
"Aggregating local descriptors into a compact image representation" (CVPR 2010).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, poses_close
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_culling import KeyframeCuller
from vo_service.slam.keyframe_database import (
    LOST_VELOCITY_SIGMA,
    KeyframeDatabase,
    MapKeyframe,
    QueryFrame,
)
from vo_service.slam.keyframe_selection import OdometryConstraint
from vo_service.slam.loop_candidates import LoopCandidates
from vo_service.slam.map_file import MapContents
from vo_service.slam.map_merger import MapMerger
from vo_service.slam.optimization_schedule import OptimizationSchedule
from vo_service.slam.place_recognizer import PlaceMatch, PlaceRecognizer
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval, PoseGraph
from vo_service.slam.relocalization import RelocalizationResult
from vo_service.types.map_snapshot import MapSnapshot

# A loop that differs from the map by more than this calls for an optimization.
MIN_CORRECTION_M, MIN_CORRECTION_RAD = 0.005, 0.005
# Largest number of loops of a keyframe; more cost time and add little.
MAX_LOOPS_PER_KEYFRAME = 3


@dataclass(frozen=True)
class KeyframeObservation:
    """A tracked frame that becomes a keyframe.

    Attributes:
        world_id: Number of the world frame of its pose.
        T_world_camera: 4x4.
        constraint: Motion from the last keyframe, if that is in this world frame.
    """

    frame: RgbdFrame
    world_id: int
    T_world_camera: Array
    constraint: OdometryConstraint


@dataclass(frozen=True)
class MapUpdate:
    """Change of the map: a new keyframe, and the removed ones."""

    keyframe: MapKeyframe
    removals: Sequence[NodeRemoval]


class LoopCloser:
    """The map of keyframes, with loop closure and relocalization.

    Args:
        recognizer: Recognizes places.
        database: The keyframes; those of a saved map are in other world frames than new ones.
        graph: Their poses and edges.
        next_number: Number of the next keyframe.
    """

    def __init__(
        self,
        recognizer: PlaceRecognizer,
        database: KeyframeDatabase,
        graph: PoseGraph,
        next_number: int = 0,
    ) -> None:
        self.database = database
        self.graph = graph
        self.loop_count = 0
        self._recognizer = recognizer
        self._candidates = LoopCandidates(database, graph)
        self._map_merger = MapMerger()
        self._keyframe_culler = KeyframeCuller(database, graph)
        self._last_keyframe: MapKeyframe | None = None
        self._next_number = next_number
        self._optimization_schedule = OptimizationSchedule()

    @property
    def T_map_world(self) -> Array:
        """4x4 correction of the poses in the current world frame."""
        last = self._last_keyframe
        if last is None:
            return np.eye(4)
        return np.asarray(self.graph.T_map_keyframe(last.number) @ inverse(last.T_world_keyframe))

    @property
    def world_id(self) -> int:
        """The current world frame: that of the last keyframe; 0 before the first one."""
        return 0 if self._last_keyframe is None else self._last_keyframe.world_id

    def anchor_to_last_keyframe(self, T_world_camera: Array) -> AnchoredPose:
        """Anchor a pose in the current world frame to the last keyframe."""
        last = self._last_keyframe
        if last is None:
            return AnchoredPose(None, T_world_camera)
        return AnchoredPose(
            last.number, np.asarray(inverse(last.T_world_keyframe) @ T_world_camera)
        )

    @property
    def contents(self) -> MapContents:
        """Contents of the map, to be saved."""
        nodes = tuple(self.graph.nodes.values())
        return MapContents(tuple(self.database), nodes, self.graph.edges, self._next_number)

    @property
    def snapshot(self) -> MapSnapshot:
        """The map as it is now."""
        rows = {number: row for row, number in enumerate(self.graph.nodes)}
        edges = self.graph.edges
        return MapSnapshot(
            T_map_odom=self.T_map_world,
            T_map_keyframe=np.array([self.graph.T_map_keyframe(number) for number in rows]).reshape(
                -1, 4, 4
            ),
            edges=np.array([(rows[e.a], rows[e.b]) for e in edges], np.int32).reshape(-1, 2),
            is_loop_closure=np.array([edge.is_loop for edge in edges], np.bool_),
            is_localized=self.is_localized,
            epoch=self.world_id,
        )

    @property
    def is_localized(self) -> bool:
        """Whether the current world frame is connected with the oldest keyframe."""
        last, oldest = self._last_keyframe, next(iter(self.database), None)
        return oldest is None or (last is not None and self._are_connected(oldest, last))

    def process_keyframe(self, observation: KeyframeObservation) -> MapUpdate:
        """Add a keyframe, close its loops, and cull the map."""
        query = self._recognizer.create_query(observation.frame, observation.constraint.velocity)
        new_keyframe = self._add_keyframe(query, observation)
        T_map_keyframe = self.graph.T_map_keyframe(new_keyframe.number)
        candidates = self._candidates.find_loop_candidates(
            query, observation.world_id, T_map_keyframe
        )
        matches = self._match_candidates(query, new_keyframe, candidates)
        # Implausible matches are dropped.
        loops = [loop for each in matches for loop in self._loop_edges(new_keyframe, each)]
        self._add_loop_closures(loops)
        self.database.add(new_keyframe)
        self._candidates.mark_visited(new_keyframe)
        # Duplicates are culled: the map grows with the explored space, not with time.
        return MapUpdate(new_keyframe, self._keyframe_culler.cull(new_keyframe, loops))

    def optimize(self) -> None:
        """Optimize the graph if there are pending loops."""
        if self._optimization_schedule.has_pending_loops:
            self.graph.optimize()
            self._optimization_schedule.mark_optimized()

    def relocalize(self, frame: RgbdFrame) -> RelocalizationResult | None:
        """Find a frame's pose in the current world frame; None if no keyframe is recognized."""
        last = self._last_keyframe
        if last is None:
            return None
        query = self._recognizer.create_query(frame, np.zeros(6), LOST_VELOCITY_SIGMA)
        keyframes = [
            each for each in self._candidates.find_similar(query) if self._are_connected(each, last)
        ]
        found = self._recognizer.recognize(query, keyframes, self._T_map_keyframes(keyframes))
        if found is None:
            return None
        T_map_camera = self.graph.T_map_keyframe(found.keyframe_number) @ found.T_keyframe_camera
        return RelocalizationResult(
            frame.seq, inverse(self.T_map_world) @ T_map_camera, found.covariance
        )

    def _add_keyframe(self, query: QueryFrame, observation: KeyframeObservation) -> MapKeyframe:
        """Create a keyframe and connect it with the last one by the odometry's motion."""
        last, number = self._last_keyframe, self._next_number
        new_keyframe = self._recognizer.create_keyframe(
            query, number, observation.world_id, observation.T_world_camera
        )
        if last is None or last.world_id != observation.world_id:
            # The correction stays until the new world frame is connected with the map.
            self.graph.add_node(
                number, observation.world_id, self.T_map_world @ observation.T_world_camera
            )
        else:
            T_last_keyframe = inverse(last.T_world_keyframe) @ observation.T_world_camera
            motion = Edge(
                last.number,
                number,
                T_last_keyframe,
                observation.constraint.covariance,
                False,
                observation.constraint.length_m,
            )
            self.graph.add_odometry_edge(motion)
        self._last_keyframe, self._next_number = new_keyframe, number + 1
        return new_keyframe

    def _match_candidates(
        self, query: QueryFrame, keyframe: MapKeyframe, candidates: Sequence[MapKeyframe]
    ) -> list[PlaceMatch]:
        """Match the view of a new keyframe with the candidates, in their order.

        Candidates in unconnected world frames are used only if they do not contradict each other.
        """
        others = [each for each in candidates if not self._are_connected(each, keyframe)]
        if (
            others
            and self._recognizer.recognize(query, others, self._T_map_keyframes(others)) is None
        ):
            candidates = [each for each in candidates if each not in others]
        found = (self._recognizer.recognize(query, [candidate]) for candidate in candidates)
        return list(islice((each for each in found if each is not None), MAX_LOOPS_PER_KEYFRAME))

    def _T_map_keyframes(self, keyframes: Sequence[MapKeyframe]) -> dict[int, Array]:
        return {each.number: self.graph.T_map_keyframe(each.number) for each in keyframes}

    def _loop_edges(self, keyframe: MapKeyframe, match: PlaceMatch) -> list[Edge]:
        """Loop edges of a match; more than one where two world frames are merged."""
        old = self.database[match.keyframe_number]
        loop = Edge(
            old.number, keyframe.number, match.T_keyframe_camera, match.covariance, True, 0.0
        )
        if not self._are_connected(old, keyframe):
            agreed = self._map_merger.add_loop(loop, old, keyframe)
            # A keyframe of a pending loop may have been culled.
            return [each for each in agreed if {each.a, each.b} <= self.graph.nodes.keys()]
        return [loop] if self.graph.is_plausible(loop) else []

    def _are_connected(self, one: MapKeyframe, other: MapKeyframe) -> bool:
        return one.world_id == other.world_id or self.graph.are_connected(
            one.world_id, other.world_id
        )

    def _add_loop_closures(self, loops: Sequence[Edge]) -> None:
        """Add loops to the graph, and optimize it when due."""
        has_inconsistency = any(self._is_inconsistent(loop) for loop in loops)
        for loop in loops:
            self.graph.add_loop_closure(loop)
        self.loop_count += len(loops)
        if self._optimization_schedule.add_keyframe(
            len(self.graph.nodes), has_loops=bool(loops), is_inconsistent=has_inconsistency
        ):
            self.optimize()

    def _is_inconsistent(self, loop: Edge) -> bool:
        T_a_b = inverse(self.graph.T_map_keyframe(loop.a)) @ self.graph.T_map_keyframe(loop.b)
        return not poses_close(T_a_b, loop.T_a_b, MIN_CORRECTION_M, MIN_CORRECTION_RAD)

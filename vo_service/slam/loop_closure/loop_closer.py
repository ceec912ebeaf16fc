"""Loop closure: a view that is a step away from the last is a place, and is compared with others.

Where one of those is known again, the graph of all places is corrected.
Pose graphs as in Kuemmerle et al., "g2o" (ICRA 2011); views are summed up as in Jegou et al.,
"Aggregating local descriptors into a compact image representation" (CVPR 2010).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, poses_close
from vo_service.odometry.relocalization import RelocalizationResult
from vo_service.slam.loop_closure.anchored_pose import AnchoredPose
from vo_service.slam.loop_closure.keyframe_culling import KeyframeCuller
from vo_service.slam.loop_closure.loop_candidates import LoopCandidates
from vo_service.slam.loop_closure.map_merger import MapMerger
from vo_service.slam.loop_closure.odometry_constraint import OdometryConstraint
from vo_service.slam.loop_closure.optimization_schedule import OptimizationSchedule
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.place_recognizer import PlaceMatch, PlaceRecognizer
from vo_service.slam.place_recognition.query_frame import LOST_VELOCITY_SIGMA, QueryFrame
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.pose_graph import NodeRemoval, PoseGraph
from vo_service.slam.saved_maps.map_file import MapContents
from vo_service.types import MapSnapshot

# A loop that says that the map is off by so much calls for a correction.
MIN_CORRECTION_M, MIN_CORRECTION_RAD = 0.005, 0.005
# So many loops of a place say where it is; more cost time and say the same.
MAX_LOOPS_PER_KEYFRAME = 3


@dataclass(frozen=True)
class KeyframeObservation:
    """A tracked frame that is to be a place.

    world           number of the world that its pose is in
    T_world_camera  4x4
    hop             from the place before, if that is of this world
    """

    frame: RgbdFrame
    world_id: int
    T_world_camera: Array
    constraint: OdometryConstraint


@dataclass(frozen=True)
class MapUpdate:
    """What has become of the map: a new place, and those that had to go for it."""

    keyframe: MapKeyframe
    removals: Sequence[NodeRemoval]


class LoopCloser:
    """Knows the places that were seen, and how they lie to each other in the map."""

    def __init__(
        self,
        recognizer: PlaceRecognizer,
        database: KeyframeDatabase,
        graph: PoseGraph,
        next_number: int = 0,
    ) -> None:
        """Places and their graph may be those of an earlier day: what comes is a new world."""
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
        """4x4 correction of the poses of the world that the camera is in."""
        last = self._last_keyframe
        if last is None:
            return np.eye(4)
        return np.asarray(self.graph.T_map_keyframe(last.number) @ inverse(last.T_world_keyframe))

    @property
    def world_id(self) -> int:
        """That the camera is in: the last place's; 0 before the first."""
        return 0 if self._last_keyframe is None else self._last_keyframe.world_id

    def anchor_to_last_keyframe(self, T_world_camera: Array) -> AnchoredPose:
        """A pose in the world of the last place, as seen from there."""
        last = self._last_keyframe
        if last is None:
            return AnchoredPose(None, T_world_camera)
        return AnchoredPose(
            last.number, np.asarray(inverse(last.T_world_keyframe) @ T_world_camera)
        )

    @property
    def contents(self) -> MapContents:
        """What there is to keep of the map."""
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
            is_localized=self._is_localized,
            epoch=self.world_id,
        )

    @property
    def _is_localized(self) -> bool:
        """Whether the world that the camera is in is joined to the oldest place of all."""
        last, oldest = self._last_keyframe, next(iter(self.database), None)
        return oldest is None or (last is not None and self._are_connected(oldest, last))

    def process_keyframe(self, observation: KeyframeObservation) -> MapUpdate:
        """Make a place of a view, and close the loops that it shows."""
        # What does it look like, and where does the odometry say it is?
        view = self._recognizer.create_query(observation.frame, observation.constraint.velocity)
        place = self._add_keyframe(view, observation)
        # Which older places does it show?
        T_map_place = self.graph.T_map_keyframe(place.number)
        older = self._candidates.find_loop_candidates(view, observation.world_id, T_map_place)
        recognised = self._match_candidates(view, place, older)
        # Is that plausible? Then the map is corrected.
        loops = [loop for each in recognised for loop in self._loop_edges(place, each)]
        self._add_loop_closures(loops)
        self.database.add(place)
        self._candidates.mark_visited(place)
        # Places that tell nothing new go: the map grows with what was seen, not with time.
        return MapUpdate(place, self._keyframe_culler.cull(place, loops))

    def optimize(self) -> None:
        """Correct the map by the loops that have waited for it."""
        if self._optimization_schedule.has_pending_loops:
            self.graph.optimize()
            self._optimization_schedule.mark_optimized()

    def relocalize(self, frame: RgbdFrame) -> RelocalizationResult | None:
        """Where a frame was taken, in the world of the last place; None if no place is known."""
        last = self._last_keyframe
        if last is None:
            return None
        view = self._recognizer.create_query(frame, np.zeros(6), LOST_VELOCITY_SIGMA)
        places = [
            each for each in self._candidates.find_similar(view) if self._are_connected(each, last)
        ]
        found = self._recognizer.recognize(view, places, self._T_map_keyframes(places))
        if found is None:
            return None
        T_map_camera = self.graph.T_map_keyframe(found.keyframe_number) @ found.T_keyframe_camera
        return RelocalizationResult(
            frame.seq, inverse(self.T_map_world) @ T_map_camera, found.covariance
        )

    def _add_keyframe(self, query: QueryFrame, observation: KeyframeObservation) -> MapKeyframe:
        """A new place, tied to the last by the motion that the odometry gave."""
        last, number = self._last_keyframe, self._next_number
        place = self._recognizer.create_keyframe(
            query, number, observation.world_id, observation.T_world_camera
        )
        if last is None or last.world_id != observation.world_id:
            # Until it is known how a new world lies, the correction stays as it was.
            self.graph.add_node(
                number, observation.world_id, self.T_map_world @ observation.T_world_camera
            )
        else:
            T_last_place = inverse(last.T_world_keyframe) @ observation.T_world_camera
            motion = Edge(
                last.number,
                number,
                T_last_place,
                observation.constraint.covariance,
                False,
                observation.constraint.length_m,
            )
            self.graph.add_odometry_edge(motion)
        self._last_keyframe, self._next_number = place, number + 1
        return place

    def _match_candidates(
        self, query: QueryFrame, keyframe: MapKeyframe, candidates: Sequence[MapKeyframe]
    ) -> list[PlaceMatch]:
        """The first of the candidates that the view of a new place shows.

        Of places in another world, whose way from here is not known, none may contradict.
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
        return {place.number: self.graph.T_map_keyframe(place.number) for place in keyframes}

    def _loop_edges(self, keyframe: MapKeyframe, match: PlaceMatch) -> list[Edge]:
        """What is to be closed of a recognition; more than one where two worlds are joined."""
        old = self.database[match.keyframe_number]
        loop = Edge(
            old.number, keyframe.number, match.T_keyframe_camera, match.covariance, True, 0.0
        )
        if not self._are_connected(old, keyframe):
            agreed = self._map_merger.add_loop(loop, old, keyframe)
            # A place that one of them waited for may have been left out since.
            return [each for each in agreed if {each.a, each.b} <= self.graph.nodes.keys()]
        return [loop] if self.graph.is_plausible(loop) else []

    def _are_connected(self, one: MapKeyframe, other: MapKeyframe) -> bool:
        return one.world_id == other.world_id or self.graph.are_connected(
            one.world_id, other.world_id
        )

    def _add_loop_closures(self, loops: Sequence[Edge]) -> None:
        """Add loops to the graph, and correct it when that is due."""
        is_off = any(self._is_inconsistent(loop) for loop in loops)
        for loop in loops:
            self.graph.add_loop_closure(loop)
        self.loop_count += len(loops)
        if self._optimization_schedule.add_keyframe(
            len(self.graph.nodes), has_loops=bool(loops), is_inconsistent=is_off
        ):
            self.optimize()

    def _is_inconsistent(self, loop: Edge) -> bool:
        T_a_b = inverse(self.graph.T_map_keyframe(loop.a)) @ self.graph.T_map_keyframe(loop.b)
        return not poses_close(T_a_b, loop.T_a_b, MIN_CORRECTION_M, MIN_CORRECTION_RAD)

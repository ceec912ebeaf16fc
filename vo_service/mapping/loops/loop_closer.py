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
from drivers.geometry import Array, are_near, inverse
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import PoseGraph, Removal
from vo_service.mapping.loops.candidates import Candidates
from vo_service.mapping.loops.correction_due import CorrectionDue
from vo_service.mapping.loops.from_place import FromPlace
from vo_service.mapping.loops.hop import Hop
from vo_service.mapping.loops.joining import Joining
from vo_service.mapping.loops.thinning import Thinning
from vo_service.mapping.places.map_file import MapContents
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.recognition import Recogniser, Recognition
from vo_service.mapping.places.view import LOST, PlaceView
from vo_service.odometry.relocalising import Located
from vo_service.types import MapSnapshot

# A loop that says that the map is off by so much calls for a correction.
OFF_M, OFF_RAD = 0.005, 0.005
# So many loops of a place say where it is; more cost time and say the same.
MOST_LOOPS = 3


@dataclass(frozen=True)
class Sight:
    """A tracked frame that is to be a place.

    world           number of the world that its pose is in
    T_world_camera  4x4
    hop             from the place before, if that is of this world
    """

    frame: RgbdFrame
    world: int
    T_world_camera: Array
    hop: Hop


@dataclass(frozen=True)
class Change:
    """What has become of the map: a new place, and those that had to go for it."""

    place: Place
    removals: Sequence[Removal]


class LoopCloser:
    """Knows the places that were seen, and how they lie to each other in the map."""

    def __init__(
        self, recogniser: Recogniser, places: Places, graph: PoseGraph, next_number: int = 0
    ) -> None:
        """Places and their graph may be those of an earlier day: what comes is a new world."""
        self.places = places
        self.graph = graph
        self.loops = 0
        self._recogniser = recogniser
        self._candidates = Candidates(places, graph)
        self._joining = Joining()
        self._thinning = Thinning(places, graph)
        self._last: Place | None = None
        self._next_number = next_number
        self._due = CorrectionDue()

    @property
    def T_map_world(self) -> Array:
        """4x4 correction of the poses of the world that the camera is in."""
        last = self._last
        if last is None:
            return np.eye(4)
        return np.asarray(self.graph.T_map(last.number) @ inverse(last.T_world_place))

    @property
    def world(self) -> int:
        """That the camera is in: the last place's; 0 before the first."""
        return 0 if self._last is None else self._last.world

    def from_last(self, T_world_camera: Array) -> FromPlace:
        """A pose in the world of the last place, as seen from there."""
        last = self._last
        if last is None:
            return FromPlace(None, T_world_camera)
        return FromPlace(last.number, np.asarray(inverse(last.T_world_place) @ T_world_camera))

    @property
    def contents(self) -> MapContents:
        """What there is to keep of the map."""
        nodes = tuple(self.graph.nodes.values())
        return MapContents(tuple(self.places), nodes, self.graph.edges, self._next_number)

    @property
    def snapshot(self) -> MapSnapshot:
        """The map as it is now."""
        rows = {number: row for row, number in enumerate(self.graph.nodes)}
        edges = self.graph.edges
        return MapSnapshot(
            T_map_odom=self.T_map_world,
            T_map_place=np.array([self.graph.T_map(number) for number in rows]).reshape(-1, 4, 4),
            edges=np.array([(rows[e.a], rows[e.b]) for e in edges], np.int32).reshape(-1, 2),
            is_loop=np.array([edge.is_loop for edge in edges], np.bool_),
            is_located=self._is_located,
            epoch=self.world,
        )

    @property
    def _is_located(self) -> bool:
        """Whether the world that the camera is in is joined to the oldest place of all."""
        last, oldest = self._last, next(iter(self.places), None)
        return oldest is None or (last is not None and self._is_joined(oldest, last))

    def see(self, sight: Sight) -> Change:
        """Make a place of a view, and close the loops that it shows."""
        # What does it look like, and where does the odometry say it is?
        view = self._recogniser.view(sight.frame, sight.hop.velocity)
        place = self._add_place(view, sight)
        # Which older places does it show?
        T_map_place = self.graph.T_map(place.number)
        older = self._candidates.of_a_loop(view, sight.world, T_map_place)
        recognised = self._recognised(view, place, older)
        # Is that plausible? Then the map is corrected.
        loops = [loop for each in recognised for loop in self._loops(place, each)]
        self._close(loops)
        self.places.add(place)
        self._candidates.passed(place)
        # Places that tell nothing new go: the map grows with what was seen, not with time.
        return Change(place, self._thinning.after(place, loops))

    def correct(self) -> None:
        """Correct the map by the loops that have waited for it."""
        if self._due.has_loops:
            self.graph.optimise()
            self._due.corrected()

    def locate(self, frame: RgbdFrame) -> Located | None:
        """Where a frame was taken, in the world of the last place; None if no place is known."""
        last = self._last
        if last is None:
            return None
        view = self._recogniser.view(frame, np.zeros(6), LOST)
        places = [each for each in self._candidates.alike(view) if self._is_joined(each, last)]
        found = self._recogniser.recognise(view, places, self._T_map(places))
        if found is None:
            return None
        T_map_camera = self.graph.T_map(found.number) @ found.T_place_camera
        return Located(frame.seq, inverse(self.T_map_world) @ T_map_camera, found.covariance)

    def _add_place(self, view: PlaceView, sight: Sight) -> Place:
        """A new place, tied to the last by the motion that the odometry gave."""
        last, number = self._last, self._next_number
        place = self._recogniser.place(view, number, sight.world, sight.T_world_camera)
        if last is None or last.world != sight.world:
            # Until it is known how a new world lies, the correction stays as it was.
            self.graph.add(number, sight.world, self.T_map_world @ sight.T_world_camera)
        else:
            T_last_place = inverse(last.T_world_place) @ sight.T_world_camera
            motion = Edge(
                last.number, number, T_last_place, sight.hop.covariance, False, sight.hop.length_m
            )
            self.graph.extend(motion)
        self._last, self._next_number = place, number + 1
        return place

    def _recognised(
        self, view: PlaceView, place: Place, candidates: Sequence[Place]
    ) -> list[Recognition]:
        """The first of the candidates that the view of a new place shows.

        Of places in another world, whose way from here is not known, none may contradict.
        """
        others = [each for each in candidates if not self._is_joined(each, place)]
        if others and self._recogniser.recognise(view, others, self._T_map(others)) is None:
            candidates = [each for each in candidates if each not in others]
        found = (self._recogniser.recognise(view, [candidate]) for candidate in candidates)
        return list(islice((each for each in found if each is not None), MOST_LOOPS))

    def _T_map(self, places: Sequence[Place]) -> dict[int, Array]:
        return {place.number: self.graph.T_map(place.number) for place in places}

    def _loops(self, place: Place, found: Recognition) -> list[Edge]:
        """What is to be closed of a recognition; more than one where two worlds are joined."""
        old = self.places[found.number]
        loop = Edge(old.number, place.number, found.T_place_camera, found.covariance, True, 0.0)
        if not self._is_joined(old, place):
            agreed = self._joining.take(loop, old, place)
            # A place that one of them waited for may have been left out since.
            return [each for each in agreed if {each.a, each.b} <= self.graph.nodes.keys()]
        return [loop] if self.graph.is_plausible(loop) else []

    def _is_joined(self, one: Place, other: Place) -> bool:
        return one.world == other.world or self.graph.is_joined(one.world, other.world)

    def _close(self, loops: Sequence[Edge]) -> None:
        """Add loops to the graph, and correct it when that is due."""
        is_off = any(self._moves_the_map(loop) for loop in loops)
        for loop in loops:
            self.graph.close(loop)
        self.loops += len(loops)
        if self._due.next(len(self.graph.nodes), has_loops=bool(loops), is_off=is_off):
            self.correct()

    def _moves_the_map(self, loop: Edge) -> bool:
        T_a_b = inverse(self.graph.T_map(loop.a)) @ self.graph.T_map(loop.b)
        return not are_near(T_a_b, loop.T_a_b, OFF_M, OFF_RAD)

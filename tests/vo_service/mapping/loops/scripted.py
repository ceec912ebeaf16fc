"""A loop closer whose places are known again as the test says, at no cost."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np

from drivers.camera import RgbdFrame
from drivers.geometry import Array, rigid_transform
from tests.vo_service.odometry.synthetic_views import view_of_a_corner
from vo_service.mapping.graph.pose_graph import PoseGraph
from vo_service.mapping.loops.hop import Hop
from vo_service.mapping.loops.loop_closer import LoopCloser, Sight
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.recognition import NOWHERE, Poses, Recogniser, Recognition
from vo_service.mapping.places.view import FOLLOWED, PlaceView

OF_MOTIONS, OF_LOOPS = np.eye(6) * 1e-5, np.eye(6) * 1e-6
STEP_M, VELOCITY = 0.3, np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0])
FRAME = view_of_a_corner(np.eye(4))


@cache
def _seen() -> tuple[Recogniser, PlaceView]:
    real = Recogniser()
    return real, real.view(FRAME, np.zeros(6))


@dataclass
class Scripted(Recogniser):
    """All views look the same, and show what `shows` says.

    shows          4x4 T_place_camera by number of the place
    contradictory  of several places at once none is recognised
    velocity       of the last view, and how well it is known
    T_map_place    of the places that were asked about last
    """

    shows: Mapping[int, Array] = field(default_factory=dict)
    contradictory: bool = False
    velocity: tuple[Array, tuple[float, float]] = field(default=(VELOCITY, FOLLOWED))
    T_map_place: Poses = field(default_factory=lambda: NOWHERE)

    def view(
        self, frame: RgbdFrame, velocity: Array, known_to: tuple[float, float] = FOLLOWED
    ) -> PlaceView:
        self.velocity = velocity, known_to
        return _seen()[1]

    def place(self, view: PlaceView, number: int, world: int, T_world_place: Array) -> Place:
        return replace(_place(), number=number, world=world, T_world_place=T_world_place)

    def recognise(
        self, view: PlaceView, places: Sequence[Place], T_map_place: Poses = NOWHERE
    ) -> Recognition | None:
        self.T_map_place = T_map_place
        shown = [place.number for place in places if place.number in self.shows]
        if not shown or (self.contradictory and len(shown) > 1):
            return None
        return Recognition(shown[0], self.shows[shown[0]], OF_LOOPS, 50)


@cache
def _place() -> Place:
    real, view = _seen()
    return real.place(view, 0, 0, np.eye(4))


def closer(most_places: int = 1000) -> tuple[LoopCloser, Scripted]:
    """It knows no place yet, and never more than so many."""
    scripted = Scripted()
    places = Places(most_bytes=most_places * _place().bytes)
    return LoopCloser(scripted, places, PoseGraph()), scripted


def ahead(way_m: float) -> Array:
    return rigid_transform(np.eye(3), [0.0, 0.0, way_m])


def sight(way_m: float, world: int = 0) -> Sight:
    """From a camera that goes straight on, so far from where its world began."""
    return Sight(FRAME, world, ahead(way_m), Hop(VELOCITY, OF_MOTIONS, STEP_M))


def walked(off_m: float, steps: int = 9) -> tuple[LoopCloser, Scripted]:
    """Straight on; the last place shows the first, so much further away than the odometry says."""
    made, scripted = closer()
    for step in range(steps):
        made.see(sight(STEP_M * step))
    scripted.shows = {0: ahead(STEP_M * steps + off_m)}
    made.see(sight(STEP_M * steps))
    scripted.shows = {}
    return made, scripted

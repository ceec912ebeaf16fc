"""Which places are looked at closely."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.mapping.loops.scripted import FRAME, STEP_M, Scripted, ahead
from vo_service.mapping.graph.pose_graph import PoseGraph
from vo_service.mapping.loops.candidates import ALIKE, IN_VIEW, RECENT, Candidates
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places


class Walk:
    """Places straight on, a step apart; those in `unlike` look like nothing."""

    def __init__(self, count: int, unlike: range = range(0)) -> None:
        self._scripted = Scripted()
        self.view = self._scripted.view(FRAME, np.zeros(6))
        self._places, self._graph = Places(10**9), PoseGraph()
        self._candidates = Candidates(self._places, self._graph)
        for number in range(count):
            self._add(number, number in unlike)

    def of_a_loop(self, way_m: float, world: int = 0) -> list[int]:
        found = self._candidates.of_a_loop(self.view, world, ahead(way_m))
        return [place.number for place in found]

    def passed(self, number: int) -> None:
        self._candidates.passed(self._places[number])

    def _add(self, number: int, is_unlike: bool) -> None:
        T = ahead(STEP_M * number)
        place = self._scripted.place(self.view, number, 0, T)
        self._graph.add(number, 0, T)
        self._places.add(_unlike(place) if is_unlike else place)


def _unlike(place: Place) -> Place:
    return replace(place, summary=np.zeros_like(place.summary))


def test_what_should_be_in_view_is_looked_at_though_it_looks_like_nothing() -> None:
    walk = Walk(ALIKE + 5, unlike=range(ALIKE, ALIKE + 5))
    near = walk.of_a_loop(STEP_M * (ALIKE + 3.2))
    assert near[:ALIKE] == list(range(ALIKE))
    assert near[ALIKE:] == [ALIKE + 3, ALIKE + 4]  # the nearest first
    assert walk.of_a_loop(100.0) == list(range(ALIKE))


def test_no_place_is_looked_at_twice() -> None:
    assert Walk(IN_VIEW).of_a_loop(0.0) == list(range(IN_VIEW))


@pytest.mark.parametrize(("world", "found"), [(0, [0]), (1, list(range(ALIKE)))])
def test_the_last_places_of_the_way_are_no_loop_but_after_a_loss_they_are(
    world: int, found: list[int]
) -> None:
    walk = Walk(RECENT + 1)
    walk.of_a_loop(0.0, world=0)
    for number in range(RECENT + 1):
        walk.passed(number)
    assert walk.of_a_loop(0.0, world) == found

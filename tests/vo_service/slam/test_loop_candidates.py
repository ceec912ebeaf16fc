"""Which keyframes are candidates for a loop."""

from dataclasses import replace

import numpy as np
import pytest

from tests.vo_service.slam.scripted_recognizer import (
    STEP_M,
    ScriptedRecognizer,
    make_frame,
    pose_ahead,
)
from vo_service.slam.keyframe_database import KeyframeDatabase, MapKeyframe
from vo_service.slam.loop_candidates import (
    MAX_NEARBY_KEYFRAMES,
    MAX_RECENT_KEYFRAMES,
    MAX_SIMILAR_KEYFRAMES,
    LoopCandidates,
)
from vo_service.slam.pose_graph import PoseGraph


class KeyframeLine:
    """Keyframes on a line, a step apart; those in `unlike` look different."""

    def __init__(self, count: int, unlike: range = range(0)) -> None:
        self._scripted = ScriptedRecognizer()
        self.view = self._scripted.create_query(make_frame(), np.zeros(6))
        self._places, self._graph = KeyframeDatabase(10**9), PoseGraph()
        self._candidates = LoopCandidates(self._places, self._graph)
        for number in range(count):
            self._add(number, number in unlike)

    def of_a_loop(self, path_m: float, world: int = 0) -> list[int]:
        found = self._candidates.find_loop_candidates(self.view, world, pose_ahead(path_m))
        return [keyframe.number for keyframe in found]

    def passed(self, number: int) -> None:
        self._candidates.mark_visited(self._places[number])

    def _add(self, number: int, is_unlike: bool) -> None:
        T = pose_ahead(STEP_M * number)
        keyframe = self._scripted.create_keyframe(self.view, number, 0, T)
        self._graph.add_node(number, 0, T)
        self._places.add(_unlike(keyframe) if is_unlike else keyframe)


def _unlike(keyframe: MapKeyframe) -> MapKeyframe:
    return replace(keyframe, vlad_descriptor=np.zeros_like(keyframe.vlad_descriptor))


def test_nearby_keyframes_are_candidates_though_they_do_not_look_similar() -> None:
    walk = KeyframeLine(
        MAX_SIMILAR_KEYFRAMES + 5, unlike=range(MAX_SIMILAR_KEYFRAMES, MAX_SIMILAR_KEYFRAMES + 5)
    )
    near = walk.of_a_loop(STEP_M * (MAX_SIMILAR_KEYFRAMES + 3.2))
    assert near[:MAX_SIMILAR_KEYFRAMES] == list(range(MAX_SIMILAR_KEYFRAMES))
    assert near[MAX_SIMILAR_KEYFRAMES:] == [
        MAX_SIMILAR_KEYFRAMES + 3,
        MAX_SIMILAR_KEYFRAMES + 4,
    ]  # the nearest first
    assert walk.of_a_loop(100.0) == list(range(MAX_SIMILAR_KEYFRAMES))


def test_no_keyframe_is_a_candidate_twice() -> None:
    assert KeyframeLine(MAX_NEARBY_KEYFRAMES).of_a_loop(0.0) == list(range(MAX_NEARBY_KEYFRAMES))


@pytest.mark.parametrize(("world", "found"), [(0, [0]), (1, list(range(MAX_SIMILAR_KEYFRAMES)))])
def test_recent_keyframes_are_no_candidates_except_after_a_loss(
    world: int, found: list[int]
) -> None:
    walk = KeyframeLine(MAX_RECENT_KEYFRAMES + 1)
    walk.of_a_loop(0.0, world=0)
    for number in range(MAX_RECENT_KEYFRAMES + 1):
        walk.passed(number)
    assert walk.of_a_loop(0.0, world) == found

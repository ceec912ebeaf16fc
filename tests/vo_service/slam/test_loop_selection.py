"""Which loops are searched, merged and optimized."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.slam.corner_trajectory import make_loop_closer, make_observation
from tests.vo_service.slam.scripted_recognizer import (
    STEP_M,
    ScriptedRecognizer,
    make_frame,
    pose_ahead,
)
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import KeyframeDatabase, MapKeyframe
from vo_service.slam.loop_selection import (
    MAX_NEARBY_KEYFRAMES,
    MAX_PENDING_KEYFRAMES,
    MAX_RECENT_KEYFRAMES,
    MAX_SIMILAR_KEYFRAMES,
    LoopCandidates,
    MapMerger,
    OptimizationSchedule,
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


T_OLD_NEW = rigid_transform(np.eye(3), [3.0, 1.0, 0.0])


def keyframes() -> tuple[MapKeyframe, MapKeyframe, MapKeyframe]:
    """One keyframe of world frame 0, two of world frame 1."""
    closer = make_loop_closer(1)
    one, other = (closer.process_keyframe(make_observation(n, 1)).keyframe for n in (1, 2))
    return closer.database[0], one, other


def loop(old: MapKeyframe, new: MapKeyframe, T_old_new: Array) -> Edge:
    T_a_b = inverse(old.T_world_keyframe) @ T_old_new @ new.T_world_keyframe
    return Edge(old.number, new.number, T_a_b, np.eye(6) * 1e-6, True, 0.0)


def test_one_loop_is_not_enough_to_merge_maps_but_two_that_agree_are() -> None:
    merger, (old, one, other) = MapMerger(), keyframes()
    first, second = loop(old, one, T_OLD_NEW), loop(old, other, T_OLD_NEW)
    assert merger.add_loop(first, old, one) == []
    assert merger.add_loop(second, old, other) == [first, second]


@pytest.mark.parametrize(("error_m", "off_rad"), [(0.2, 0.0), (0.0, 0.1)])
def test_two_contradicting_loops_do_not_merge_maps(error_m: float, off_rad: float) -> None:
    merger, (old, one, other) = MapMerger(), keyframes()
    off = rigid_transform(so3_exp([0.0, 0.0, off_rad]), [error_m, 0.0, 0.0])
    assert merger.add_loop(loop(old, one, T_OLD_NEW), old, one) == []
    assert merger.add_loop(loop(old, other, T_OLD_NEW @ off), old, other) == []


def test_a_hypothesis_for_one_world_does_not_count_for_another() -> None:
    merger, (old, one, other) = MapMerger(), keyframes()
    of_a_third = replace(other, world_id=2)
    assert merger.add_loop(loop(old, one, T_OLD_NEW), old, one) == []
    assert merger.add_loop(loop(old, of_a_third, T_OLD_NEW), old, of_a_third) == []


def corrections(keyframes: int, loops: list[bool | None]) -> list[int]:
    """Keyframes after which the map is optimized. True is an inconsistent loop, None no loop."""
    due, found = OptimizationSchedule(), []
    for number, loop in enumerate(loops):
        if due.add_keyframe(keyframes, has_loops=loop is not None, is_inconsistent=loop is True):
            due.mark_optimized()
            found.append(number)
    return found


def test_an_inconsistent_map_is_optimized_at_once() -> None:
    assert corrections(50, [None, True, None, True, True]) == [1, 3, 4]


def test_a_map_without_loops_is_never_optimized() -> None:
    assert corrections(50, [None] * 100) == []
    assert not OptimizationSchedule().has_pending_loops


def test_consistent_loops_wait_for_ten_keyframes() -> None:
    assert corrections(50, [False] + [None] * 30) == [MAX_PENDING_KEYFRAMES]
    assert corrections(50, [False] * 30) == [10, 21]


def test_a_large_map_waits_for_more_keyframes() -> None:
    assert corrections(500, [None] * 9 + [True, True] + [None] * 9) == [9, 14]
    assert corrections(3000, [False] * 70) == [10, 40]


def test_the_first_loop_optimizes_a_loaded_map() -> None:
    assert corrections(3000, [None, True]) == [1]


@given(st.integers(1, 2000), st.lists(st.sampled_from([True, False, None]), max_size=200))
def test_the_waiting_time_of_a_loop_is_limited_by_the_size_of_the_map(
    keyframes: int, loops: list[bool | None]
) -> None:
    found = corrections(keyframes, loops)
    longest = max(MAX_PENDING_KEYFRAMES, keyframes // 100 + 1)
    waiting = [n for n, loop in enumerate(loops) if loop is not None and n + longest < len(loops)]
    assert all(any(n <= at <= n + longest for at in found) for n in waiting)
    assert all(later - before >= keyframes / 100 for before, later in pairwise(found))

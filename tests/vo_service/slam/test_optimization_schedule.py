"""When the pose graph is optimized."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from vo_service.slam.optimization_schedule import MAX_PENDING_KEYFRAMES, OptimizationSchedule


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

"""Keyframe culling: the map grows with the explored space, not with time."""

import pytest

from tests.vo_service.slam.loop_closure.corner_trajectory import (
    STEPS,
    make_loop_closer,
    make_observation,
)
from tests.vo_service.slam.loop_closure.scripted_recognizer import (
    STEP_M,
    closer_after_walk,
    pose_ahead,
)
from tests.vo_service.slam.loop_closure.scripted_recognizer import make_observation as straight_on
from vo_service.slam.keyframe_selector import STEP_M as ONE_STEP_M
from vo_service.slam.loop_closure.keyframe_culling import MAX_DUPLICATE_STEPS

LAST_M = 9 * STEP_M


@pytest.mark.parametrize(("steps", "stays"), [(MAX_DUPLICATE_STEPS - 0.1, False), (2.0, True)])
def test_a_duplicate_keyframe_is_removed_when_the_next_has_come(steps: float, stays: bool) -> None:
    made, scripted = closer_after_walk(error_m=0.0)
    scripted.matches = {1: pose_ahead(ONE_STEP_M * steps)}
    repeated = made.process_keyframe(straight_on(STEP_M + ONE_STEP_M * steps)).keyframe.number
    scripted.matches = {}
    assert repeated in made.database
    change = made.process_keyframe(straight_on(LAST_M))
    assert (repeated in made.database) is stays
    assert [removal.number for removal in change.removals] == ([] if stays else [repeated])
    assert set(made.graph.nodes) == {place.number for place in made.database}


def test_a_keyframe_with_an_implausible_loop_closure_stays() -> None:
    made, scripted = closer_after_walk(error_m=0.0)
    scripted.matches = {1: pose_ahead(0.1)}
    repeated = made.process_keyframe(straight_on(LAST_M + 5.0)).keyframe.number
    made.process_keyframe(straight_on(LAST_M + 5.3))
    assert repeated in made.database


@pytest.mark.slow
def test_repeated_visits_add_few_keyframes() -> None:
    made = make_loop_closer(STEPS + 1)
    once = len(made.database)
    for n in range(STEPS + 1, 4 * STEPS):
        made.process_keyframe(make_observation(n))
    assert once == STEPS + 1
    assert len(made.database) <= 1.5 * once < 2 * STEPS

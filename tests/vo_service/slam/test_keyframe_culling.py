"""Redundant keyframes are removed."""

import numpy as np
import pytest

from drivers.core.geometry import Array
from tests.vo_service.slam.corner_keyframes import make_pose
from tests.vo_service.slam.corner_trajectory import (
    STEPS,
    make_loop_closer,
    make_observation,
)
from tests.vo_service.slam.scripted_recognizer import (
    STEP_M,
    closer_after_walk,
    pose_ahead,
)
from tests.vo_service.slam.scripted_recognizer import make_observation as straight_on
from vo_service.slam.keyframe_culling import MAX_DUPLICATE_STEPS, find_most_redundant
from vo_service.slam.keyframe_selection import STEP_M as ONE_STEP_M


def along(*positions_m: float) -> Array:
    return np.array([make_pose((path_m, 0.0, 0.0)) for path_m in positions_m])


def redundant(poses: Array) -> int:
    """Of places that are all connected."""
    return find_most_redundant(poses, np.zeros(len(poses), np.int64))


def test_the_keyframe_nearest_to_others_is_culled() -> None:
    assert redundant(along(0.0, 1.0, 2.0, 2.1, 2.3, 5.0)) == 3


def test_a_rotation_counts_like_a_distance() -> None:
    turned = [make_pose((0.0, 0.0, 0.0), (0.0, degrees, 0.0)) for degrees in (0, 60, 65, 120)]
    assert redundant(np.array(turned)) == 2


def test_the_first_and_the_newest_keyframe_are_never_culled() -> None:
    assert redundant(along(0.0, 0.1, 3.0, 6.0, 6.1)) in (1, 3)
    assert redundant(along(0.0, 5.0, 0.0)) == 1
    with pytest.raises(ValueError, match="never culled"):
        redundant(along(0.0, 0.0))


def test_unconnected_keyframes_are_not_near() -> None:
    poses = along(0.0, 1.0, 1.5, 1.01, 1.02, 9.0)
    assert find_most_redundant(poses, np.array([0, 0, 0, 1, 2, 3])) == 1
    assert find_most_redundant(poses, np.array([0, 0, 0, 1, 0, 0])) in (1, 4)


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
    for n in range(STEPS + 1, 3 * STEPS):
        made.process_keyframe(make_observation(n))
    assert once == STEPS + 1
    assert len(made.database) <= 1.5 * once < 2 * STEPS

"""The map after loop closures."""

import numpy as np
import pytest

from drivers.core.geometry import Array
from tests.vo_service.slam.scripted_recognizer import (
    LOOP_COVARIANCE,
    ODOMETRY_COVARIANCE,
    STEP_M,
    VELOCITY,
    ScriptedRecognizer,
    closer_after_walk,
    make_loop_closer,
    make_observation,
    pose_ahead,
)
from vo_service.slam.keyframe_database import (
    LOST_VELOCITY_SIGMA,
    TRACKED_VELOCITY_SIGMA,
)
from vo_service.slam.loop_closer import MAX_LOOPS_PER_KEYFRAME, LoopCloser
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval

LAST = 9
LAST_M = LAST * STEP_M


def path_m(T: Array) -> float:
    """Distance of a pose straight ahead."""
    return float(T[2, 3])


def optimized() -> tuple[LoopCloser, ScriptedRecognizer]:
    """Three keyframes, all of them candidates of a view."""
    made, scripted = closer_after_walk(error_m=0.02)
    for number in range(1, LAST - 1):
        made.database.remove(number)
        made.graph.remove_node(number)
    return made, scripted


def test_an_inconsistent_loop_closure_optimizes_the_map_at_once() -> None:
    made, _ = closer_after_walk(error_m=0.02)
    assert path_m(made.graph.T_map_keyframe(LAST)) == pytest.approx(LAST_M + 0.02, abs=1e-3)
    assert path_m(made.T_map_world) == pytest.approx(0.02, abs=1e-3)


def test_a_view_of_many_keyframes_closes_three_loops() -> None:
    made, scripted = make_loop_closer()
    for step in range(15):
        made.process_keyframe(make_observation(STEP_M * step))
    scripted.matches = {number: pose_ahead(STEP_M * (15 - number)) for number in range(7)}
    made.process_keyframe(make_observation(STEP_M * 15))
    assert made.loop_count == MAX_LOOPS_PER_KEYFRAME == 3


def test_edges_have_the_reported_motion_and_covariance() -> None:
    made, scripted = closer_after_walk(error_m=0.02)
    *motions, loop = made.graph.edges
    assert len(motions) == LAST
    assert all(np.array_equal(motion.covariance, ODOMETRY_COVARIANCE) for motion in motions)
    assert {motion.length_m for motion in motions} == {STEP_M}
    assert np.array_equal(loop.covariance, LOOP_COVARIANCE)
    assert (loop.is_loop, loop.length_m) == (True, 0.0)
    velocity, velocity_sigma = scripted.velocity
    assert np.array_equal(velocity, VELOCITY)
    assert velocity_sigma == TRACKED_VELOCITY_SIGMA


def test_an_earlier_pose_is_optimized_with_its_keyframe() -> None:
    made, _ = closer_after_walk(error_m=0.02)
    T_map = made.graph.T_map_keyframe
    seen = made.anchor_to_last_keyframe(pose_ahead(2.8))
    assert seen.keyframe_number == LAST
    assert path_m(seen.to_map(T_map)) == pytest.approx(2.82, abs=1e-3)
    assert path_m(AnchoredPose(0, pose_ahead(0.1)).to_map(T_map)) == pytest.approx(0.1)
    assert path_m(AnchoredPose(None, pose_ahead(0.1)).to_map(T_map)) == 0.1
    seen = AnchoredPose(1, pose_ahead(0.4))
    before = seen.to_map(T_map)
    seen = seen.re_anchor(made.graph.remove_node(1))
    assert seen.keyframe_number in (0, 2)
    assert np.allclose(seen.to_map(T_map), before)


def test_until_a_new_world_is_connected_the_correction_stays() -> None:
    made, scripted = optimized()
    before = made.T_map_world
    number = made.process_keyframe(make_observation(0.0, world=4)).keyframe.number
    assert np.allclose(made.T_map_world, before)
    assert (made.snapshot.epoch, made.snapshot.is_localized) == (4, False)
    scripted.matches = {0: pose_ahead(1.0)}
    assert made.relocalize(make_observation(0.0).frame) is None
    scripted.matches = {number: pose_ahead(1.0)}
    result = made.relocalize(make_observation(0.0).frame)
    assert result is not None
    assert np.allclose(result.T_world_camera, pose_ahead(1.0))


def test_a_relocalization_has_the_covariance_of_the_recognition() -> None:
    made, scripted = optimized()
    scripted.matches = {LAST: pose_ahead(1.0)}
    result = made.relocalize(make_observation(0.0).frame)
    assert result is not None
    assert np.allclose(result.T_world_camera, pose_ahead(LAST_M + 1.0))
    assert np.array_equal(result.covariance, LOOP_COVARIANCE)
    velocity, velocity_sigma = scripted.velocity
    assert not velocity.any()  # nothing is known of it
    assert velocity_sigma == LOST_VELOCITY_SIGMA
    assert np.array_equal(
        scripted.T_map_place[LAST], made.graph.T_map_keyframe(LAST)
    )  # rivals show


def test_keyframes_of_an_unconnected_world_are_not_near() -> None:
    made, _ = make_loop_closer(max_keyframes=5)
    for way in (0.0, 3.0):
        made.process_keyframe(make_observation(way))
    removed: list[NodeRemoval] = []
    for way in (3.0, 6.0, 6.6, 9.0):  # the first looks as if it were at the place at 3 m
        removed += made.process_keyframe(make_observation(way, world=1)).removals
    assert [removal.number for removal in removed] == [4]


def test_the_first_and_the_newest_keyframe_stay_at_any_memory_limit() -> None:
    made, _ = make_loop_closer(max_keyframes=0)
    for step in range(5):
        made.process_keyframe(make_observation(STEP_M * step))
    assert [place.number for place in made.database] == [0, 4]

"""Loop closure and relocalization of the loop closer."""

import numpy as np
import pytest

from drivers.core.geometry import inverse, rigid_transform, so3_exp
from tests.vo_service.odometry.synthetic_views import render_corner
from tests.vo_service.slam.corner_trajectory import (
    STEPS,
    keyframe_error_m,
    make_loop_closer,
    make_observation,
    odometry_pose,
    true_pose,
)
from vo_service.config_tables import MapConfig
from vo_service.slam.loop_candidates import MAX_RECENT_KEYFRAMES
from vo_service.slam.loop_closer import LoopCloser
from vo_service.slam.synchronous_loop_closure import create_loop_closer_from_map

ELSEWHERE = rigid_transform(so3_exp([0.0, 0.0, 2.0]), [7.0, -3.0, 1.0])


@pytest.fixture(scope="module")
def walked() -> LoopCloser:
    """Out and back."""
    return make_loop_closer(2 * STEPS + 1)


def test_a_loop_closure_removes_the_drift(walked: LoopCloser) -> None:
    drift_m = float(np.linalg.norm(odometry_pose(2 * STEPS)[:3, 3] - true_pose(2 * STEPS)[:3, 3]))
    assert walked.loop_count >= 3
    assert keyframe_error_m(walked, 2 * STEPS) < 0.2 * drift_m


def test_an_outward_trajectory_has_no_loop_closure() -> None:
    assert make_loop_closer(MAX_RECENT_KEYFRAMES + 1).loop_count == 0


def test_a_frame_at_a_known_keyframe_is_localized_in_the_odometry_world(
    walked: LoopCloser,
) -> None:
    result = walked.relocalize(render_corner(true_pose(3), 99))
    assert result is not None
    assert result.seq == 99
    # The world frame of the odometry has its drift.
    T_last_camera = inverse(odometry_pose(2 * STEPS)) @ result.T_world_camera
    expected = inverse(true_pose(2 * STEPS)) @ true_pose(3)
    assert np.allclose(T_last_camera, expected, atol=0.01)


def test_an_implausible_loop_closure_is_rejected() -> None:
    closer = make_loop_closer(MAX_RECENT_KEYFRAMES + 1)
    far = rigid_transform(np.eye(3), [1.5, 0.0, 0.0])  # says the odometry, 15 cm after the last
    for n in (2 * STEPS - 2, 2 * STEPS - 1, 2 * STEPS):
        closer.process_keyframe(make_observation(n, 0, far))
    assert closer.loop_count == 0


def test_a_new_world_is_connected_when_two_keyframes_agree() -> None:
    closer = make_loop_closer(1)
    is_localized = []
    for n in (1, 2):
        closer.process_keyframe(make_observation(n, 1, ELSEWHERE))
        is_localized.append(closer.snapshot.is_localized)
    assert is_localized == [False, True]
    T_map_camera = closer.T_map_world @ ELSEWHERE @ odometry_pose(2)
    assert np.allclose(T_map_camera[:3, 3], true_pose(2)[:3, 3], atol=0.03)


def test_a_keyframe_removed_before_the_optimization_causes_no_error() -> None:
    closer = make_loop_closer(1)
    waiting = closer.process_keyframe(make_observation(1, 1, ELSEWHERE)).keyframe
    closer.process_keyframe(make_observation(1))  # the newest place is never left out
    closer.database.remove(waiting.number)
    closer.graph.remove_node(waiting.number)
    closer.process_keyframe(make_observation(2, 1, ELSEWHERE))
    assert {place.number for place in closer.database} == set(closer.graph.nodes)


def test_a_saved_map_is_recognized_in_the_next_session() -> None:
    saved = make_loop_closer(STEPS).contents
    closer = create_loop_closer_from_map(saved, MapConfig())
    assert len(closer.database) == STEPS
    for n in (STEPS + 3, STEPS + 5):
        closer.process_keyframe(make_observation(n, 0, ELSEWHERE))
    assert closer.snapshot.is_localized
    T_map_camera = closer.T_map_world @ ELSEWHERE @ odometry_pose(STEPS + 5)
    assert np.allclose(T_map_camera[:3, 3], true_pose(STEPS + 5)[:3, 3], atol=0.03)

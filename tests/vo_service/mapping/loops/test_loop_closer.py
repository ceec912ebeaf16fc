"""Places that are known again, and the map that they correct."""

import numpy as np
import pytest

from drivers.geometry import inverse, rigid_transform, rotation_from_vector
from tests.vo_service.mapping.loops.corner_walk import (
    STEPS,
    closer_after,
    error_m,
    sight,
    told,
    truth,
)
from tests.vo_service.odometry.synthetic_views import frame_of, textured_image, view_of_a_corner
from vo_service.mapping.loops.candidates import RECENT
from vo_service.mapping.loops.loop_closer import LoopCloser
from vo_service.mapping.loops.opening import closer_in, new_closer
from vo_service.settings import MapSettings

ELSEWHERE = rigid_transform(rotation_from_vector([0.0, 0.0, 2.0]), [7.0, -3.0, 1.0])


@pytest.fixture(scope="module")
def walked() -> LoopCloser:
    """Out and back."""
    return closer_after(2 * STEPS + 1)


def test_a_way_back_is_known_again_and_the_drift_is_gone(walked: LoopCloser) -> None:
    drift_m = float(np.linalg.norm(told(2 * STEPS)[:3, 3] - truth(2 * STEPS)[:3, 3]))
    assert walked.loops >= 3
    assert error_m(walked, 2 * STEPS) < 0.2 * drift_m


def test_a_way_out_is_no_loop() -> None:
    assert closer_after(RECENT + 1).loops == 0


def test_a_frame_of_a_known_place_is_located_in_the_world_of_the_odometry(
    walked: LoopCloser,
) -> None:
    located = walked.locate(view_of_a_corner(truth(3), 99))
    assert located is not None
    assert located.seq == 99
    # The world of the odometry is told the same way as the last pose was: drift and all.
    T_last_camera = inverse(told(2 * STEPS)) @ located.T_world_camera
    expected = inverse(truth(2 * STEPS)) @ truth(3)
    assert np.allclose(T_last_camera, expected, atol=0.01)


def test_a_view_of_nothing_known_is_located_nowhere(walked: LoopCloser) -> None:
    elsewhere = frame_of(textured_image(240, 320, seed=9), np.full((240, 320), 2.0))
    assert walked.locate(elsewhere) is None
    assert new_closer(MapSettings()).locate(elsewhere) is None


def test_a_loop_that_the_odometry_cannot_have_missed_is_not_believed() -> None:
    closer = closer_after(RECENT + 1)
    far = rigid_transform(np.eye(3), [1.5, 0.0, 0.0])  # says the odometry, 15 cm after the last
    for n in (2 * STEPS - 2, 2 * STEPS - 1, 2 * STEPS):
        closer.see(sight(n, 0, far))
    assert closer.loops == 0


def test_a_new_world_is_joined_when_two_places_say_so_alike() -> None:
    closer = closer_after(1)
    is_located = []
    for n in (1, 2):
        closer.see(sight(n, 1, ELSEWHERE))
        is_located.append(closer.snapshot.is_located)
    assert is_located == [False, True]
    T_map_camera = closer.T_map_world @ ELSEWHERE @ told(2)
    assert np.allclose(T_map_camera[:3, 3], truth(2)[:3, 3], atol=0.03)


def test_a_place_that_was_left_out_while_a_loop_waited_is_not_missed() -> None:
    closer = closer_after(1)
    waiting = closer.see(sight(1, 1, ELSEWHERE)).place
    closer.see(sight(1))  # the newest place is never left out
    closer.places.remove(waiting.number)
    closer.graph.remove(waiting.number)
    closer.see(sight(2, 1, ELSEWHERE))
    assert {place.number for place in closer.places} == set(closer.graph.nodes)


def test_a_map_that_was_kept_is_known_the_next_day() -> None:
    kept = closer_after(STEPS).contents
    closer = closer_in(kept, MapSettings())
    assert len(closer.places) == STEPS
    for n in (STEPS + 3, STEPS + 5):
        closer.see(sight(n, 0, ELSEWHERE))
    assert closer.snapshot.is_located
    T_map_camera = closer.T_map_world @ ELSEWHERE @ told(STEPS + 5)
    assert np.allclose(T_map_camera[:3, 3], truth(STEPS + 5)[:3, 3], atol=0.03)


def test_places_near_others_go_when_there_are_too_many() -> None:
    few = closer_after(STEPS)
    limit_mb = 1 + few.places.bytes // 1_000_000
    closer = new_closer(MapSettings(places_mb=limit_mb))
    removed = [
        removal.number for n in range(2 * STEPS + 1) for removal in closer.see(sight(n)).removals
    ]
    assert removed
    assert closer.places.bytes <= 1_000_000 * limit_mb
    assert {place.number for place in closer.places} == set(closer.graph.nodes)


def test_the_same_walk_gives_the_same_map_bit_for_bit(walked: LoopCloser) -> None:
    again = closer_after(2 * STEPS + 1)
    assert np.array_equal(again.snapshot.T_map_place, walked.snapshot.T_map_place)

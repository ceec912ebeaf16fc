"""Which loops merge two world frames."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.slam.corner_trajectory import make_loop_closer, make_observation
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import MapKeyframe
from vo_service.slam.map_merger import MapMerger

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

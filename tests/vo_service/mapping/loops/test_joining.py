"""Two worlds are one when two loops say so alike."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.geometry import Array, inverse, rigid_transform, rotation_from_vector
from tests.vo_service.mapping.loops.corner_walk import closer_after, sight
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.loops.joining import Joining
from vo_service.mapping.places.place import Place

T_OLD_NEW = rigid_transform(np.eye(3), [3.0, 1.0, 0.0])


def places() -> tuple[Place, Place, Place]:
    """One of world 0, two of world 1."""
    closer = closer_after(1)
    one, other = (closer.see(sight(n, 1)).place for n in (1, 2))
    return closer.places[0], one, other


def loop(old: Place, new: Place, T_old_new: Array) -> Edge:
    T_a_b = inverse(old.T_world_place) @ T_old_new @ new.T_world_place
    return Edge(old.number, new.number, T_a_b, np.eye(6) * 1e-6, True, 0.0)


def test_one_loop_is_not_believed_and_two_that_agree_are() -> None:
    joining, (old, one, other) = Joining(), places()
    first, second = loop(old, one, T_OLD_NEW), loop(old, other, T_OLD_NEW)
    assert joining.take(first, old, one) == []
    assert joining.take(second, old, other) == [first, second]


@pytest.mark.parametrize(("off_m", "off_rad"), [(0.2, 0.0), (0.0, 0.1)])
def test_two_loops_that_contradict_each_other_are_not_believed(
    off_m: float, off_rad: float
) -> None:
    joining, (old, one, other) = Joining(), places()
    off = rigid_transform(rotation_from_vector([0.0, 0.0, off_rad]), [off_m, 0.0, 0.0])
    assert joining.take(loop(old, one, T_OLD_NEW), old, one) == []
    assert joining.take(loop(old, other, T_OLD_NEW @ off), old, other) == []


def test_what_is_said_of_one_world_is_no_opinion_of_another() -> None:
    joining, (old, one, other) = Joining(), places()
    of_a_third = replace(other, world=2)
    assert joining.take(loop(old, one, T_OLD_NEW), old, one) == []
    assert joining.take(loop(old, of_a_third, T_OLD_NEW), old, of_a_third) == []

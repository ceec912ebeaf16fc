"""Places, joined by motions and loops."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.geometry import Array, inverse, is_rigid, rigid_transform, rotation_from_vector
from tests.vo_service.mapping.graph.rings import (
    LOOP,
    NONE,
    loop,
    noise,
    place_on,
    poses,
    rms_m,
    walk,
)
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import PoseGraph

RING = 30
LAP = [place_on(RING, k) for k in range(RING + 1)]
SHIFT = rigid_transform(rotation_from_vector([0.3, -0.2, 1.0]), [5.0, -3.0, 1.0])
NOT_OFF = np.eye(4)
FEW = settings(max_examples=10)


def seen_again(
    a: int,
    b: int,
    truth: list[Array] = LAP,
    rng: np.random.Generator | None = None,
    off: Array = NOT_OFF,
) -> Edge:
    """A loop that is right, with its noise where a generator is given; or one that is wrong."""
    error = np.eye(4) if rng is None else noise(rng, LOOP)
    return loop(a, b, inverse(truth[a]) @ truth[b] @ error @ off)


def closed(seed: int, steps: int = RING) -> PoseGraph:
    """A lap, closed by a loop from its end to its begin."""
    truth, rng = [place_on(steps, k) for k in range(steps + 1)], np.random.default_rng(seed)
    graph = walk(truth, rng)
    graph.close(seen_again(0, steps, truth, rng))
    graph.optimise()
    return graph


@FEW
@given(st.integers(0, RING - 2), st.integers(0, 1000))
def test_a_loop_that_says_what_is_known_changes_nothing(a: int, seed: int) -> None:
    graph = walk(LAP, np.random.default_rng(seed))
    before = poses(graph)
    graph.close(loop(a, RING, inverse(graph.T_map(a)) @ graph.T_map(RING)))
    graph.optimise()
    np.testing.assert_allclose(poses(graph), before, atol=1e-10)


def test_without_a_loop_the_places_are_where_the_odometry_said_to_the_bit() -> None:
    graph = walk(LAP, np.random.default_rng(1))
    graph.optimise()
    for node in graph.nodes.values():
        np.testing.assert_array_equal(node.T_map_place, node.T_world_place)


def test_a_noisy_ring_is_closed_and_errs_less_by_what_theory_says() -> None:
    # A random walk errs by n / 2 of a step's variance on average, one that is tied at both ends
    # (a bridge) by n / 6: the square root of 3 less. Turns are left out, whose errors grow faster.
    truth = [place_on(RING, k) for k in range(RING + 1)]
    before, after = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        graph = walk(truth, rng, sigma=(4e-3, 0.0))
        before.append(rms_m(graph, truth) ** 2)
        graph.close(loop(0, RING, np.eye(4), sigma=(1e-4, 1e-4)))
        graph.optimise()
        np.testing.assert_allclose(graph.T_map(RING), LAP[RING], atol=2e-4)
        after.append(rms_m(graph, truth) ** 2)
    assert np.sqrt(np.mean(before) / np.mean(after)) == pytest.approx(np.sqrt(3.0), rel=0.15)


def test_the_first_place_stays_where_it_is_to_the_bit() -> None:
    graph = closed(seed=3)
    np.testing.assert_array_equal(graph.T_map(0), np.eye(4))
    assert all(is_rigid(T, tolerance=1e-12) for T in poses(graph))


def test_the_same_graph_gives_the_same_bits() -> None:
    np.testing.assert_array_equal(poses(closed(seed=4)), poses(closed(seed=4)))


def test_a_graph_that_was_kept_goes_on_as_if_nothing_had_been() -> None:
    graph = closed(seed=5)
    kept = PoseGraph(graph.nodes.values(), graph.edges)
    for each in (graph, kept):
        each.close(seen_again(5, 25))
        each.optimise()
    np.testing.assert_array_equal(poses(kept), poses(graph))


def test_a_wrong_loop_that_slipped_through_bends_nothing_much() -> None:
    truth = [place_on(RING, k) for k in range(2 * RING + 1)]
    rng = np.random.default_rng(6)
    graph = walk(truth, rng)
    for k in range(0, RING, 3):
        graph.close(seen_again(k, k + RING, truth, rng))
    graph.optimise()
    right, before = rms_m(graph, truth), poses(graph)
    wrong = seen_again(2, RING + 14, truth, off=rigid_transform(np.eye(3), [0.2, 0.0, 0.0]))
    graph.close(wrong)
    graph.optimise()
    assert np.max(np.abs(poses(graph) - before)) < 0.05 * 0.2
    assert rms_m(graph, truth) < right + 0.003
    assert [edge for edge in graph.edges if edge not in graph.believed()] == [wrong]


@pytest.mark.parametrize(
    ("off_m", "off_deg", "is_plausible"),
    [
        (0.0, 0.0, True),
        (0.25, 0.0, True),
        (0.0, 7.0, True),
        (0.4, 0.0, False),
        (0.0, 12.0, False),
    ],
)
def test_a_loop_is_plausible_if_the_odometry_can_have_been_so_wrong(
    off_m: float, off_deg: float, is_plausible: bool
) -> None:
    graph = walk(LAP, np.random.default_rng(7), sigma=NONE)
    error = rigid_transform(
        rotation_from_vector([0.0, np.deg2rad(off_deg), 0.0]), [0.0, 0.0, off_m]
    )
    # Over a lap of 12.6 m: 30 cm and 8.3 degrees.
    assert graph.is_plausible(loop(0, RING, LAP[RING] @ error)) is is_plausible


def test_after_a_loop_the_way_is_shorter_and_less_is_plausible() -> None:
    graph = walk(LAP, np.random.default_rng(8), sigma=NONE)
    doubtful = seen_again(1, RING, off=rigid_transform(np.eye(3), [0.2, 0.0, 0.0]))
    assert graph.is_plausible(doubtful)
    graph.close(seen_again(0, RING))
    graph.optimise()
    assert not graph.is_plausible(doubtful)


def test_two_worlds_are_joined_and_the_younger_comes_to_the_older() -> None:
    graph = walk(LAP, np.random.default_rng(9), sigma=NONE)
    walk(LAP, np.random.default_rng(9), sigma=NONE, graph=graph, first=100, world=1)
    assert not graph.is_joined(0, 1)
    np.testing.assert_array_equal(graph.T_map(100), np.eye(4))
    joint = loop(110, 4, inverse(LAP[10]) @ SHIFT @ LAP[4])
    assert graph.is_plausible(joint)
    graph.close(joint)
    graph.optimise()
    assert graph.is_joined(0, 1)
    older, younger = poses(graph)[: RING + 1], poses(graph)[RING + 1 :]
    np.testing.assert_allclose(older, LAP, atol=1e-9)
    np.testing.assert_allclose(younger, inverse(SHIFT) @ LAP, atol=1e-9)
    np.testing.assert_allclose(graph.nodes[105].T_world_place, LAP[5], atol=1e-12)


def test_a_joined_world_goes_on_in_the_frame_of_the_older() -> None:
    graph = walk(LAP[:3], np.random.default_rng(1), sigma=NONE)
    graph.add(7, 1, np.eye(4))
    graph.close(loop(0, 7, SHIFT))
    (step,) = walk(LAP[:2], np.random.default_rng(1), sigma=NONE).edges
    graph.extend(Edge(7, 8, step.T_a_b, step.covariance, False, step.length_m))
    np.testing.assert_allclose(graph.T_map(8), SHIFT @ LAP[1], atol=1e-12)
    assert graph.nodes[8].world == 1


def test_a_world_comes_to_the_older_one_whichever_end_of_the_loop_it_is_at() -> None:
    graph = walk(LAP[:3], np.random.default_rng(1), sigma=NONE)
    walk(LAP[:2], np.random.default_rng(1), sigma=NONE, graph=graph, first=10, world=1)
    walk(LAP[:2], np.random.default_rng(1), sigma=NONE, graph=graph, first=20, world=2)
    graph.close(loop(0, 20, SHIFT))
    graph.close(loop(10, 21, inverse(SHIFT)))  # from the younger to what is joined to the oldest
    np.testing.assert_allclose(graph.T_map(10), SHIFT @ LAP[1] @ SHIFT, atol=1e-12)
    np.testing.assert_allclose(graph.T_map(21), SHIFT @ LAP[1], atol=1e-12)


def test_the_oldest_place_of_each_part_stays_to_the_bit() -> None:
    graph = walk(LAP, np.random.default_rng(1))
    walk(LAP, np.random.default_rng(2), graph=graph, first=100, world=1)
    for first in (0, 100):
        graph.close(loop(first, first + RING, LAP[RING]))
    before = poses(graph)
    graph.optimise()
    is_held = np.isin(list(graph.nodes), (0, 100))
    np.testing.assert_array_equal(poses(graph)[is_held], before[is_held])
    assert not np.any(np.all(poses(graph) == before, axis=(1, 2)) & ~is_held)


def test_a_motion_is_believed_though_surer_loops_say_that_it_was_off() -> None:
    graph = walk(LAP[:2], np.random.default_rng(1), sigma=NONE)
    off = rigid_transform(np.eye(3), [0.025, 0.0, 0.0])  # six standard deviations of the motion
    for _ in range(5):
        graph.close(loop(0, 1, LAP[1] @ off, sigma=(1e-3, 1e-3)))
    graph.optimise()
    np.testing.assert_allclose(graph.T_map(1), LAP[1] @ off, atol=1e-3)
    assert graph.believed() == graph.edges


def test_hundreds_of_places_and_loops_agree() -> None:
    per_lap, laps = 80, 5
    truth = [place_on(per_lap, k) for k in range(per_lap * laps)]
    rng = np.random.default_rng(10)
    graph = walk(truth, rng)
    drifted = rms_m(graph, truth)
    while len(graph.edges) < 800:
        a = int(rng.integers(0, per_lap * (laps - 1)))
        graph.close(seen_again(a, a + per_lap, truth, rng))
    graph.optimise()
    assert rms_m(graph, truth) < 0.25 * drifted
    assert len(graph.believed()) >= 795

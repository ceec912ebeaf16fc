"""Pose graph with odometry edges and loops."""

import numpy as np
import pytest
from hypothesis import settings

from drivers.core.geometry import Array, inverse, rigid_transform, so3_exp
from tests.vo_service.slam.ring_graphs import (
    LOOP_SIGMA,
    NO_SIGMA,
    graph_poses,
    loop_edge,
    make_graph,
    ring_pose,
    rms_error_m,
    sample_noise,
)
from vo_service.slam.graph_edges import Edge
from vo_service.slam.pose_graph import PoseGraph

RING = 30
LAP = [ring_pose(RING, k) for k in range(RING + 1)]
SHIFT = rigid_transform(so3_exp([0.3, -0.2, 1.0]), [5.0, -3.0, 1.0])
NOT_OFF = np.eye(4)
FEW = settings(max_examples=10)


def seen_again(
    a: int,
    b: int,
    truth: list[Array] = LAP,
    rng: np.random.Generator | None = None,
    off: Array = NOT_OFF,
) -> Edge:
    """A loop with noise if a generator is given, and with an error `off`."""
    error = np.eye(4) if rng is None else sample_noise(rng, LOOP_SIGMA)
    return loop_edge(a, b, inverse(truth[a]) @ truth[b] @ error @ off)


def closed(seed: int, steps: int = RING) -> PoseGraph:
    """A ring, closed by a loop from its end to its start."""
    truth, rng = [ring_pose(steps, k) for k in range(steps + 1)], np.random.default_rng(seed)
    graph = make_graph(truth, rng)
    graph.add_loop_closure(seen_again(0, steps, truth, rng))
    graph.optimize()
    return graph


def test_without_a_loop_keyframes_have_the_odometry_poses_bit_for_bit() -> None:
    graph = make_graph(LAP, np.random.default_rng(1))
    graph.optimize()
    for node in graph.nodes.values():
        np.testing.assert_array_equal(node.T_map_keyframe, node.T_world_keyframe)


def test_closing_a_noisy_ring_reduces_the_error_as_theory_predicts() -> None:
    # A random walk errs by n / 2 of a step's variance on average, one that is tied at both ends
    # (a bridge) by n / 6: the square root of 3 less. Turns are left out, whose errors grow faster.
    truth = [ring_pose(RING, k) for k in range(RING + 1)]
    before, after = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        graph = make_graph(truth, rng, sigma=(4e-3, 0.0))
        before.append(rms_error_m(graph, truth) ** 2)
        graph.add_loop_closure(loop_edge(0, RING, np.eye(4), sigma=(1e-4, 1e-4)))
        graph.optimize()
        np.testing.assert_allclose(graph.T_map_keyframe(RING), LAP[RING], atol=2e-4)
        after.append(rms_error_m(graph, truth) ** 2)
    assert np.sqrt(np.mean(before) / np.mean(after)) == pytest.approx(np.sqrt(3.0), rel=0.15)


def test_a_loaded_graph_continues_as_before() -> None:
    graph = closed(seed=5)
    saved = PoseGraph(graph.nodes.values(), graph.edges)
    for each in (graph, saved):
        each.add_loop_closure(seen_again(5, 25))
        each.optimize()
    np.testing.assert_array_equal(graph_poses(saved), graph_poses(graph))


def test_a_wrong_loop_has_little_effect() -> None:
    truth = [ring_pose(RING, k) for k in range(2 * RING + 1)]
    rng = np.random.default_rng(6)
    graph = make_graph(truth, rng)
    for k in range(0, RING, 3):
        graph.add_loop_closure(seen_again(k, k + RING, truth, rng))
    graph.optimize()
    right, before = rms_error_m(graph, truth), graph_poses(graph)
    wrong = seen_again(2, RING + 14, truth, off=rigid_transform(np.eye(3), [0.2, 0.0, 0.0]))
    graph.add_loop_closure(wrong)
    graph.optimize()
    assert np.max(np.abs(graph_poses(graph) - before)) < 0.05 * 0.2
    assert rms_error_m(graph, truth) < right + 0.003
    assert [edge for edge in graph.edges if edge not in graph.inlier_edges()] == [wrong]


@pytest.mark.parametrize(
    ("error_m", "off_deg", "is_plausible"),
    [
        (0.0, 0.0, True),
        (0.25, 0.0, True),
        (0.0, 7.0, True),
        (0.4, 0.0, False),
        (0.0, 12.0, False),
    ],
)
def test_a_loop_is_plausible_within_the_drift_of_the_odometry(
    error_m: float, off_deg: float, is_plausible: bool
) -> None:
    graph = make_graph(LAP, np.random.default_rng(7), sigma=NO_SIGMA)
    error = rigid_transform(so3_exp([0.0, np.deg2rad(off_deg), 0.0]), [0.0, 0.0, error_m])
    # Over a lap of 12.6 m: 30 cm and 8.3 degrees.
    assert graph.is_plausible(loop_edge(0, RING, LAP[RING] @ error)) is is_plausible


def test_after_a_loop_the_path_is_shorter_and_the_limit_tighter() -> None:
    graph = make_graph(LAP, np.random.default_rng(8), sigma=NO_SIGMA)
    doubtful = seen_again(1, RING, off=rigid_transform(np.eye(3), [0.2, 0.0, 0.0]))
    assert graph.is_plausible(doubtful)
    graph.add_loop_closure(seen_again(0, RING))
    graph.optimize()
    assert not graph.is_plausible(doubtful)


def test_connecting_two_worlds_moves_the_newer_to_the_older() -> None:
    graph = make_graph(LAP, np.random.default_rng(9), sigma=NO_SIGMA)
    make_graph(LAP, np.random.default_rng(9), sigma=NO_SIGMA, graph=graph, first=100, world=1)
    assert not graph.are_connected(0, 1)
    np.testing.assert_array_equal(graph.T_map_keyframe(100), np.eye(4))
    joint = loop_edge(110, 4, inverse(LAP[10]) @ SHIFT @ LAP[4])
    assert graph.is_plausible(joint)
    graph.add_loop_closure(joint)
    graph.optimize()
    assert graph.are_connected(0, 1)
    older, younger = graph_poses(graph)[: RING + 1], graph_poses(graph)[RING + 1 :]
    np.testing.assert_allclose(older, LAP, atol=1e-9)
    np.testing.assert_allclose(younger, inverse(SHIFT) @ LAP, atol=1e-9)
    np.testing.assert_allclose(graph.nodes[105].T_world_keyframe, LAP[5], atol=1e-12)


def test_a_connected_world_continues_in_the_frame_of_the_older() -> None:
    graph = make_graph(LAP[:3], np.random.default_rng(1), sigma=NO_SIGMA)
    graph.add_node(7, 1, np.eye(4))
    graph.add_loop_closure(loop_edge(0, 7, SHIFT))
    (step,) = make_graph(LAP[:2], np.random.default_rng(1), sigma=NO_SIGMA).edges
    graph.add_odometry_edge(Edge(7, 8, step.T_a_b, step.covariance, False, step.length_m))
    np.testing.assert_allclose(graph.T_map_keyframe(8), SHIFT @ LAP[1], atol=1e-12)
    assert graph.nodes[8].world_id == 1


def test_a_world_moves_to_the_older_one_for_either_direction_of_the_loop() -> None:
    graph = make_graph(LAP[:3], np.random.default_rng(1), sigma=NO_SIGMA)
    make_graph(LAP[:2], np.random.default_rng(1), sigma=NO_SIGMA, graph=graph, first=10, world=1)
    make_graph(LAP[:2], np.random.default_rng(1), sigma=NO_SIGMA, graph=graph, first=20, world=2)
    graph.add_loop_closure(loop_edge(0, 20, SHIFT))
    graph.add_loop_closure(
        loop_edge(10, 21, inverse(SHIFT))
    )  # from the younger to what is joined to the oldest
    np.testing.assert_allclose(graph.T_map_keyframe(10), SHIFT @ LAP[1] @ SHIFT, atol=1e-12)
    np.testing.assert_allclose(graph.T_map_keyframe(21), SHIFT @ LAP[1], atol=1e-12)


def test_the_oldest_keyframe_of_each_component_is_fixed_bit_for_bit() -> None:
    graph = make_graph(LAP, np.random.default_rng(1))
    make_graph(LAP, np.random.default_rng(2), graph=graph, first=100, world=1)
    for first in (0, 100):
        graph.add_loop_closure(loop_edge(first, first + RING, LAP[RING]))
    before = graph_poses(graph)
    graph.optimize()
    is_fixed = np.isin(list(graph.nodes), (0, 100))
    np.testing.assert_array_equal(graph_poses(graph)[is_fixed], before[is_fixed])
    assert not np.any(np.all(graph_poses(graph) == before, axis=(1, 2)) & ~is_fixed)


def test_an_odometry_edge_is_kept_against_more_certain_loops() -> None:
    graph = make_graph(LAP[:2], np.random.default_rng(1), sigma=NO_SIGMA)
    off = rigid_transform(np.eye(3), [0.025, 0.0, 0.0])  # six standard deviations of the motion
    for _ in range(5):
        graph.add_loop_closure(loop_edge(0, 1, LAP[1] @ off, sigma=(1e-3, 1e-3)))
    graph.optimize()
    np.testing.assert_allclose(graph.T_map_keyframe(1), LAP[1] @ off, atol=1e-3)
    assert graph.inlier_edges() == graph.edges


def test_hundreds_of_keyframes_and_loops_converge() -> None:
    per_lap, laps = 80, 5
    truth = [ring_pose(per_lap, k) for k in range(per_lap * laps)]
    rng = np.random.default_rng(10)
    graph = make_graph(truth, rng)
    drifted = rms_error_m(graph, truth)
    while len(graph.edges) < 800:
        a = int(rng.integers(0, per_lap * (laps - 1)))
        graph.add_loop_closure(seen_again(a, a + per_lap, truth, rng))
    graph.optimize()
    assert rms_error_m(graph, truth) < 0.25 * drifted
    assert len(graph.inlier_edges()) >= 795

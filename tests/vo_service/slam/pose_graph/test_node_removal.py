"""Removal of nodes: the others stay connected and keep their poses."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.geometry import Array, inverse, rigid_transform
from tests.vo_service.slam.pose_graph.ring_graphs import (
    LOOP_SIGMA,
    NO_SIGMA,
    graph_poses,
    loop_edge,
    make_graph,
    ring_pose,
    rms_error_m,
    sample_noise,
)
from vo_service.slam.pose_graph.connectivity import connected_components
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.node_removal import marginalize_edges
from vo_service.slam.pose_graph.pose_graph import PoseGraph

RING = 20
TRUTH = [ring_pose(RING, k) for k in range(2 * RING)]
FEW = settings(max_examples=8)


def two_laps(seed: int) -> PoseGraph:
    """Every fourth place is known again a lap later."""
    rng = np.random.default_rng(seed)
    graph = make_graph(TRUTH, rng)
    for k in range(0, RING, 4):
        T = inverse(TRUTH[k]) @ TRUTH[k + RING] @ sample_noise(rng, LOOP_SIGMA)
        graph.add_loop_closure(loop_edge(k, k + RING, T))
    graph.optimize()
    return graph


@FEW
@given(st.integers(0, 2 * RING - 1), st.integers(0, 100))
def test_removing_a_node_does_not_move_the_others(number: int, seed: int) -> None:
    graph = two_laps(seed)
    before = np.delete(graph_poses(graph), number, axis=0)
    graph.remove_node(number)
    np.testing.assert_array_equal(graph_poses(graph), before)
    graph.optimize()
    # Edges passed on over one edge share its error, which their covariances do not show. That moves
    # the poses by less than their error.
    np.testing.assert_allclose(graph_poses(graph), before, atol=0.01)


def test_a_node_with_two_edges_is_removed_without_loss() -> None:
    graph = two_laps(seed=1)
    graph.optimize()
    before = graph.T_map_keyframe(9)
    for number in (10, 11, 13, 14, 15):
        graph.remove_node(number)
    graph.optimize()
    np.testing.assert_allclose(graph.T_map_keyframe(9), before, atol=2e-4)


@FEW
@given(st.permutations(range(2 * RING)))
def test_connected_nodes_stay_connected_after_removals(order: list[int]) -> None:
    graph = two_laps(seed=2)
    for number in order[:-1]:
        graph.remove_node(number)
        assert len(connected_components(graph.nodes, graph.edges)) == 1
        if len(graph.nodes) % 8 == 0:
            graph.optimize()
            assert np.all(np.isfinite(graph_poses(graph)))
    assert list(graph.nodes) == order[-1:]
    assert not graph.edges


def test_worlds_stay_connected_when_their_connecting_nodes_are_removed() -> None:
    graph = make_graph(TRUTH[:6], np.random.default_rng(3))
    make_graph(TRUTH[:6], np.random.default_rng(4), graph=graph, first=10, world=1)
    graph.add_loop_closure(loop_edge(2, 13, inverse(TRUTH[2]) @ TRUTH[3]))
    before = graph.T_map_keyframe(15)
    graph.remove_node(2)
    graph.remove_node(13)
    assert graph.are_connected(0, 1)
    graph.optimize()
    np.testing.assert_allclose(graph.T_map_keyframe(15), before, atol=1e-9)


def test_when_the_first_keyframe_is_removed_the_next_oldest_is_fixed() -> None:
    graph = two_laps(seed=5)
    graph.remove_node(0)
    before = graph.T_map_keyframe(1)
    graph.add_loop_closure(loop_edge(3, 23, inverse(TRUTH[3]) @ TRUTH[23]))
    graph.optimize()
    np.testing.assert_array_equal(graph.T_map_keyframe(1), before)


def test_an_odometry_edge_inherits_before_a_more_certain_loop() -> None:
    saved_wall, onward = make_graph(TRUTH[:3], np.random.default_rng(6)).edges
    revisited = loop_edge(7, 1, np.eye(4), sigma=(1e-6, 1e-6))
    motions, loop_closure = [
        [
            edge
            for edge in marginalize_edges(1, [saved_wall, onward, revisited])
            if edge.is_loop is is_loop
        ]
        for is_loop in (False, True)
    ]
    assert [{edge.a, edge.b} for edge in motions] == [{0, 2}]
    assert [len({edge.a, edge.b} & {0, 2, 7}) for edge in loop_closure] == [2]


def test_a_right_loop_is_inherited_despite_a_more_certain_wrong_one() -> None:
    graph = make_graph(TRUTH[:12], np.random.default_rng(7), sigma=NO_SIGMA)
    off = rigid_transform(np.eye(3), [1.0, 0.0, 0.0])
    wrong = loop_edge(2, 11, inverse(TRUTH[2]) @ TRUTH[11] @ off, sigma=(1e-6, 1e-6))
    graph.add_loop_closure(loop_edge(1, 11, inverse(TRUTH[1]) @ TRUTH[11]))
    graph.add_loop_closure(wrong)
    assert wrong not in graph.inlier_edges()
    assert graph.remove_node(1).neighbor == 2
    assert [{edge.a, edge.b} for edge in graph.inlier_edges() if edge.is_loop] == [{2, 11}]


def test_an_unconnected_node_leaves_no_edge() -> None:
    graph = PoseGraph()
    graph.add_node(4, 0, TRUTH[3])
    removal = graph.remove_node(4)
    assert (removal.number, removal.neighbor) == (4, None)
    np.testing.assert_array_equal(removal.T_neighbor_removed, TRUTH[3])  # from the map
    assert not graph.nodes
    assert not graph.edges


def test_the_number_of_edges_stays_bounded_over_hours() -> None:
    rng, truth = np.random.default_rng(8), [ring_pose(RING, k) for k in range(15 * RING)]
    graph, edges = make_graph(truth[:1], rng), []
    for k in range(1, len(truth)):
        graph.add_odometry_edge(_step(k, truth, rng))
        for known in [n for n in graph.nodes if n < k and (k - n) % RING in (0, 1)][:2]:
            graph.add_loop_closure(
                loop_edge(
                    known, k, inverse(truth[known]) @ truth[k] @ sample_noise(rng, LOOP_SIGMA)
                )
            )
        if k > 2 * RING:
            graph.remove_node(list(graph.nodes)[1 + int(rng.integers(0, 2 * RING - 1))])
            edges.append(len(graph.edges))
    assert max(edges[-3 * RING :]) < 1.3 * max(edges[: 3 * RING])
    graph.optimize()
    assert rms_error_m(graph, truth) < 0.03
    assert np.all(np.isfinite(graph_poses(graph)))


def _step(k: int, truth: list[Array], rng: np.random.Generator) -> Edge:
    (step,) = make_graph([truth[k - 1], truth[k]], rng).edges
    return Edge(k - 1, k, step.T_a_b, step.covariance, step.is_loop, step.length_m)


def test_removing_a_redundant_keyframe_keeps_the_path_and_drops_its_loops() -> None:
    graph = two_laps(seed=3)
    before = graph_poses(graph)
    revisited = RING + 4
    own_edges = [edge for edge in graph.edges if revisited in (edge.a, edge.b)]
    assert [edge.is_loop for edge in own_edges] == [False, False, True]
    removal = graph.remove_redundant_node(own_edges[2])
    np.testing.assert_array_equal(graph_poses(graph), np.delete(before, revisited, axis=0))
    ends = {revisited - 1, revisited + 1}
    past = [edge for edge in graph.edges if {edge.a, edge.b} == ends]
    assert [edge.length_m for edge in past] == [sum(edge.length_m for edge in own_edges)]
    assert len(graph.edges) == 2 * RING - 2 + RING // 4 - 1
    assert removal.neighbor == own_edges[2].a
    np.testing.assert_array_equal(removal.T_neighbor_removed, own_edges[2].T_a_b)


def test_a_keyframe_at_the_end_of_a_path_passes_its_loops_on() -> None:
    graph = two_laps(seed=3)
    for number in range(2 * RING - 1, RING + 16, -1):
        graph.remove_node(number)
    graph.remove_redundant_node(
        next(edge for edge in graph.edges if edge.is_loop and edge.b == RING + 16)
    )
    assert len(connected_components(graph.nodes, graph.edges)) == 1
    assert any(edge.is_loop and RING + 15 in (edge.a, edge.b) for edge in graph.edges)

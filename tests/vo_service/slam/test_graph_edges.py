"""Edges of the pose graph: composition, connectivity, removal of nodes."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components as scipy_connected_components
from scipy.sparse.csgraph import dijkstra

from drivers.core.geometry import Array, inverse, rigid_transform
from tests.vo_service.slam.ring_graphs import (
    LOOP_SIGMA,
    NO_SIGMA,
    graph_poses,
    loop_edge,
    make_covariance,
    make_graph,
    odometry_edge,
    ring_pose,
    rms_error_m,
    sample_noise,
)
from vo_service.slam.graph_edges import (
    Edge,
    build_adjacency,
    connected_components,
    marginalize_edges,
    shortest_path_length,
)
from vo_service.slam.pose_graph import PoseGraph
from vo_service.slam.pose_graph_solver import invert_poses, retract_poses, so3_log_batch

T_AB, T_BC = ring_pose(7, 1), ring_pose(5, 2)
# Different in every direction, so that swapped axes are detected.
SIGMA = np.array([1.0, 2.0, 3.0, 0.5, 1.0, 1.5]) * 1e-3
SAMPLES = 4000


def edge(a: int, b: int, T_a_b: Array) -> Edge:
    return Edge(a, b, T_a_b, np.diag(SIGMA**2), is_loop=False, length_m=2.0)


def sample_edges(T: Array, seed: int) -> Array:
    """(SAMPLES, 4, 4) samples of T with the covariance."""
    steps = np.random.default_rng(seed).normal(0.0, SIGMA, (SAMPLES, 6))
    return retract_poses(np.tile(T, (SAMPLES, 1, 1)), steps)


def assert_spread(samples: Array, truth: Array, covariance: Array) -> None:
    """Check that the samples have the covariance, as small motions in the axes of b."""
    T = inverse(truth) @ samples
    found = np.cov(np.hstack([T[:, :3, 3], so3_log_batch(T[:, :3, :3])]).T)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    np.testing.assert_allclose(whitening @ found @ whitening.T, np.eye(6), atol=0.1)


def test_a_reversed_edge_is_the_inverse_with_its_covariance() -> None:
    back = edge(1, 2, T_AB).oriented_from(2)
    assert (back.a, back.b, back.length_m) == (2, 1, 2.0)
    np.testing.assert_allclose(back.T_a_b, inverse(T_AB))
    assert_spread(invert_poses(sample_edges(T_AB, 1)), inverse(T_AB), back.covariance)


def test_two_composed_edges_have_both_covariances() -> None:
    both = edge(1, 2, T_AB).compose(edge(2, 3, T_BC))
    assert (both.a, both.b, both.length_m) == (1, 3, 4.0)
    np.testing.assert_allclose(both.T_a_b, T_AB @ T_BC, atol=1e-15)
    assert_spread(sample_edges(T_AB, 1) @ sample_edges(T_BC, 2), T_AB @ T_BC, both.covariance)


def test_a_composition_with_a_loop_is_no_odometry_edge() -> None:
    saved_wall, revisited = odometry_edge(1, 2, T_AB), loop_edge(2, 3, T_BC)
    assert saved_wall.compose(revisited).is_loop
    assert revisited.oriented_from(3).compose(saved_wall.oriented_from(2)).is_loop
    assert not saved_wall.compose(odometry_edge(2, 3, T_BC)).is_loop


FEW = settings(max_examples=40)
NODES = 8


def path_edge(a: int, b: int, length_m: float) -> Edge:
    return Edge(a, b, np.eye(4), make_covariance((1e-3, 1e-3)), is_loop=False, length_m=length_m)


def edges() -> st.SearchStrategy[list[Edge]]:
    keyframe = st.integers(0, NODES - 1)
    ends = st.tuples(keyframe, keyframe).filter(lambda ends: ends[0] != ends[1])
    length_m = st.sampled_from([0.25, 0.5, 1.0, 3.0])
    return st.lists(
        st.builds(lambda ab, m: path_edge(ab[0], ab[1], m), ends, length_m), max_size=12
    )


def table(edges: list[Edge]) -> Array:
    """(PLACES, PLACES) lengths; of several edges between two places the shortest, 0 for none."""
    lengths = np.full((NODES, NODES), np.inf)
    for each in edges:
        for ends in ((each.a, each.b), (each.b, each.a)):
            lengths[ends] = min(lengths[ends], each.length_m)
    return np.where(np.isinf(lengths), 0.0, lengths)


@FEW
@given(edges())
def test_the_shortest_path_is_found_in_the_graph(edges: list[Edge]) -> None:
    expected, adjacency = dijkstra(table(edges)), build_adjacency(edges)
    for a in range(NODES):
        for b in range(NODES):
            assert (
                shortest_path_length(a, b, adjacency, lambda edge: edge.length_m) == expected[a, b]
            )


@FEW
@given(edges())
def test_connected_nodes_form_one_component(edges: list[Edge]) -> None:
    count, labels = scipy_connected_components(table(edges))
    found = connected_components(range(NODES), edges)
    assert sorted(keyframe for component in found for keyframe in component) == list(range(NODES))
    assert len(found) == count
    assert all(len({labels[keyframe] for keyframe in component}) == 1 for component in found)
    assert [min(component) for component in found] == sorted(min(component) for component in found)


def test_a_path_over_loops_has_no_length() -> None:
    edges = [path_edge(0, 1, 0.0), path_edge(1, 2, 0.0), path_edge(0, 2, 1.0)]
    assert shortest_path_length(0, 2, build_adjacency(edges), lambda edge: edge.length_m) == 0.0


@FEW
@given(edges(), st.sampled_from([0.0, 0.25, 0.75, 2.0]))
def test_the_search_stops_at_the_maximum_length(edges: list[Edge], at_most: float) -> None:
    expected, adjacency = dijkstra(table(edges)), build_adjacency(edges)
    for b in range(NODES):
        found = shortest_path_length(0, b, adjacency, lambda edge: edge.length_m, at_most)
        assert found == (expected[0, b] if expected[0, b] <= at_most else np.inf)


RING = 20
TRUTH = [ring_pose(RING, k) for k in range(2 * RING)]
FEWER = settings(max_examples=8)


def two_laps(seed: int) -> PoseGraph:
    """Every fourth place is known again a lap later."""
    rng = np.random.default_rng(seed)
    graph = make_graph(TRUTH, rng)
    for k in range(0, RING, 4):
        T = inverse(TRUTH[k]) @ TRUTH[k + RING] @ sample_noise(rng, LOOP_SIGMA)
        graph.add_loop_closure(loop_edge(k, k + RING, T))
    graph.optimize()
    return graph


@FEWER
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


@FEWER
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
    rng, truth = np.random.default_rng(8), [ring_pose(RING, k) for k in range(9 * RING)]
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

"""Components and shortest paths, compared with SciPy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components as scipy_connected_components
from scipy.sparse.csgraph import dijkstra

from drivers.core.geometry import Array
from tests.vo_service.slam.pose_graph.ring_graphs import make_covariance
from vo_service.slam.pose_graph.connectivity import (
    build_adjacency,
    connected_components,
    shortest_path_length,
)
from vo_service.slam.pose_graph.edges import Edge

FEW = settings(max_examples=40)
NODES = 8


def edge(a: int, b: int, length_m: float) -> Edge:
    return Edge(a, b, np.eye(4), make_covariance((1e-3, 1e-3)), is_loop=False, length_m=length_m)


def edges() -> st.SearchStrategy[list[Edge]]:
    keyframe = st.integers(0, NODES - 1)
    ends = st.tuples(keyframe, keyframe).filter(lambda ends: ends[0] != ends[1])
    length_m = st.sampled_from([0.25, 0.5, 1.0, 3.0])
    return st.lists(st.builds(lambda ab, m: edge(ab[0], ab[1], m), ends, length_m), max_size=12)


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
    edges = [edge(0, 1, 0.0), edge(1, 2, 0.0), edge(0, 2, 1.0)]
    assert shortest_path_length(0, 2, build_adjacency(edges), lambda edge: edge.length_m) == 0.0


@FEW
@given(edges(), st.sampled_from([0.0, 0.25, 0.75, 2.0]))
def test_the_search_stops_at_the_maximum_length(edges: list[Edge], at_most: float) -> None:
    expected, adjacency = dijkstra(table(edges)), build_adjacency(edges)
    for b in range(NODES):
        found = shortest_path_length(0, b, adjacency, lambda edge: edge.length_m, at_most)
        assert found == (expected[0, b] if expected[0, b] <= at_most else np.inf)

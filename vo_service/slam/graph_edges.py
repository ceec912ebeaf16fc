"""Edges of the pose graph: connectivity, shortest paths, and the removal of a node."""

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, orthonormalize, transport_covariance


@dataclass(frozen=True, eq=False)
class Edge:
    """Relative pose of keyframe b in the axes of keyframe a.

    Attributes:
        a: Number of a keyframe.
        b: Number of a keyframe.
        T_a_b: 4x4.
        covariance: 6x6 of T_a_b, (translation m, rotation rad), as a small motion in b's axes.
        is_loop: Whether it is a loop closure; otherwise an odometry edge.
        length_m: Length of the camera's path; 0 for a loop closure.
    """

    a: int
    b: int
    T_a_b: Array
    covariance: Array
    is_loop: bool
    length_m: float

    @property
    def variance_m2(self) -> float:
        """Uncertainty as one number: variance of points at a distance of a meter."""
        return float(np.trace(self.covariance))

    def other_end(self, end: int) -> int:
        """The other one of the two nodes."""
        return self.a + self.b - end

    def oriented_from(self, end: int) -> "Edge":
        """Return the edge with this node as a."""
        if end == self.a:
            return self
        T_b_a = inverse(self.T_a_b)
        covariance = transport_covariance(self.covariance, T_b_a)
        return Edge(self.b, self.a, T_b_a, covariance, self.is_loop, self.length_m)

    def compose(self, following: "Edge") -> "Edge":
        """Compose the edge with a following one; the result is a loop if either is."""
        return Edge(
            self.a,
            following.b,
            orthonormalize(self.T_a_b @ following.T_a_b),
            transport_covariance(self.covariance, following.T_a_b) + following.covariance,
            self.is_loop or following.is_loop,
            self.length_m + following.length_m,
        )


# The edges of each node that has any.
Adjacency = MutableMapping[int, list[Edge]]


def build_adjacency(edges: Iterable[Edge]) -> Adjacency:
    adjacency: Adjacency = defaultdict(list)
    for edge in edges:
        add_to_adjacency(adjacency, edge)
    return adjacency


def add_to_adjacency(adjacency: Adjacency, edge: Edge) -> None:
    adjacency[edge.a].append(edge)
    adjacency[edge.b].append(edge)


def connected_components(numbers: Iterable[int], edges: Iterable[Edge]) -> list[set[int]]:
    """Find the connected components of nodes; the one with the oldest node is first."""
    adjacency = build_adjacency(edges)
    remaining, visited = set(numbers), []
    while remaining:
        component = _reachable_nodes(min(remaining), adjacency)
        visited.append(component)
        remaining -= component
    return visited


def _reachable_nodes(start: int, adjacency: Mapping[int, list[Edge]]) -> set[int]:
    """Nodes that are reachable from a node, including itself."""
    visited, queue = {start}, [start]
    while queue:
        node = queue.pop()
        new_nodes = {edge.other_end(node) for edge in adjacency.get(node, ())} - visited
        visited |= new_nodes
        queue += new_nodes
    return visited


def shortest_path_length(
    start: int,
    goal: int,
    adjacency: Mapping[int, list[Edge]],
    length: Callable[[Edge], float],
    max_length: float = np.inf,
) -> float:
    """Length of the shortest path.

    Dijkstra, "A note on two problems in connexion with graphs" (1959).

    Args:
        start: Number of a node.
        goal: Number of a node.
        max_length: Longer paths are not searched.

    Returns:
        The length; infinite without a path of at most `max_length`.
    """
    lengths = {start: 0.0}
    queue = [(0.0, start)]
    while queue:
        path_length, node = heapq.heappop(queue)
        if node == goal:
            return path_length
        if path_length > lengths[node]:
            continue
        for edge in adjacency.get(node, ()):
            next_node, next_length = edge.other_end(node), path_length + length(edge)
            if next_length <= max_length and next_length < lengths.get(next_node, np.inf):
                lengths[next_node] = next_length
                heapq.heappush(queue, (next_length, next_node))
    return np.inf


def marginalize_edges(number: int, edges: Sequence[Edge]) -> list[Edge]:
    """Move the edges of a removed node to one of its neighbors.

    Each other edge is composed with the edge to that neighbor. It is preferably connected by an
    odometry edge, as a loop may be wrong, and by the most certain one.

    Returns:
        The edges, odometry edges first, then loops, the most certain first.
    """
    link = edge_to_neighbor(number, edges)
    if link is None:
        return []
    from_neighbor = link.oriented_from(link.b)
    own_edges = (edge.oriented_from(number) for edge in edges if number in (edge.a, edge.b))
    return sorted(
        (from_neighbor.compose(edge) for edge in own_edges if edge.b != link.b), key=_edge_priority
    )


def edge_to_neighbor(number: int, edges: Sequence[Edge]) -> Edge | None:
    """The edge from a node to the neighbor that gets its edges; None if it has no edge."""
    own_edges = (edge.oriented_from(number) for edge in edges if number in (edge.a, edge.b))
    return min(own_edges, key=_edge_priority, default=None)


def is_informative(loop: Edge, adjacency: Mapping[int, list[Edge]]) -> bool:
    """Whether no path over other edges is as certain as the loop.

    Only such loops are passed on; else their number would grow without bound.
    """
    variance_m2 = loop.variance_m2
    return (
        shortest_path_length(loop.a, loop.b, adjacency, lambda edge: edge.variance_m2, variance_m2)
        == np.inf
    )


def _edge_priority(edge: Edge) -> tuple[bool, float]:
    return edge.is_loop, edge.variance_m2

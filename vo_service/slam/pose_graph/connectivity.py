"""Connected components and shortest paths of a pose graph."""

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, MutableMapping

import numpy as np

from vo_service.slam.pose_graph.edges import Edge

# The edges of each node that has any.
Adjacency = MutableMapping[int, list[Edge]]


def build_adjacency(edges: Iterable[Edge]) -> Adjacency:
    """Build the adjacency of edges."""
    adjacency: Adjacency = defaultdict(list)
    for edge in edges:
        add_to_adjacency(adjacency, edge)
    return adjacency


def add_to_adjacency(adjacency: Adjacency, edge: Edge) -> None:
    """Add an edge to the adjacency."""
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
        adjacency: See `build_adjacency`.
        length: Length of an edge.
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

"""What is connected in a graph of places, and how far apart."""

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, MutableMapping

import numpy as np

from vo_service.slam.pose_graph.edges import Edge

# The edges at each place that has any.
Adjacency = MutableMapping[int, list[Edge]]


def build_adjacency(edges: Iterable[Edge]) -> Adjacency:
    """The edges at each place that has any."""
    around: Adjacency = defaultdict(list)
    for edge in edges:
        add_to_adjacency(around, edge)
    return around


def add_to_adjacency(adjacency: Adjacency, edge: Edge) -> None:
    """Add an edge to what `neighbours` found."""
    adjacency[edge.a].append(edge)
    adjacency[edge.b].append(edge)


def connected_components(numbers: Iterable[int], edges: Iterable[Edge]) -> list[set[int]]:
    """The places, parted by what edges connect; the part with the oldest place comes first."""
    around = build_adjacency(edges)
    left, found = set(numbers), []
    while left:
        part = _reachable_nodes(min(left), around)
        found.append(part)
        left -= part
    return found


def _reachable_nodes(start: int, adjacency: Mapping[int, list[Edge]]) -> set[int]:
    """The places that edges lead to from this one, itself among them."""
    found, waiting = {start}, [start]
    while waiting:
        place = waiting.pop()
        new = {edge.other_end(place) for edge in adjacency.get(place, ())} - found
        found |= new
        waiting += new
    return found


def shortest_path_length(
    start: int,
    goal: int,
    adjacency: Mapping[int, list[Edge]],
    length: Callable[[Edge], float],
    max_length: float = np.inf,
) -> float:
    """Length of the shortest way over edges; infinite where none is as short as asked for.

    Dijkstra, "A note on two problems in connexion with graphs" (1959).

    around  see `neighbours`
    """
    far = {start: 0.0}
    waiting = [(0.0, start)]
    while waiting:
        so_far, place = heapq.heappop(waiting)
        if place == goal:
            return so_far
        if so_far > far[place]:
            continue
        for edge in adjacency.get(place, ()):
            next_place, there = edge.other_end(place), so_far + length(edge)
            if there <= max_length and there < far.get(next_place, np.inf):
                far[next_place] = there
                heapq.heappush(waiting, (there, next_place))
    return np.inf

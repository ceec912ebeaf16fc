"""What is connected in a graph of places, and how far apart."""

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, MutableMapping

import numpy as np

from vo_service.mapping.graph.edges import Edge

# The edges at each place that has any.
Around = MutableMapping[int, list[Edge]]


def neighbours(edges: Iterable[Edge]) -> Around:
    """The edges at each place that has any."""
    around: Around = defaultdict(list)
    for edge in edges:
        connect(around, edge)
    return around


def connect(around: Around, edge: Edge) -> None:
    """Add an edge to what `neighbours` found."""
    around[edge.a].append(edge)
    around[edge.b].append(edge)


def parts(numbers: Iterable[int], edges: Iterable[Edge]) -> list[set[int]]:
    """The places, parted by what edges connect; the part with the oldest place comes first."""
    around = neighbours(edges)
    left, found = set(numbers), []
    while left:
        part = _reached(min(left), around)
        found.append(part)
        left -= part
    return found


def _reached(start: int, around: Mapping[int, list[Edge]]) -> set[int]:
    """The places that edges lead to from this one, itself among them."""
    found, waiting = {start}, [start]
    while waiting:
        place = waiting.pop()
        new = {edge.other(place) for edge in around.get(place, ())} - found
        found |= new
        waiting += new
    return found


def shortest(
    start: int,
    goal: int,
    around: Mapping[int, list[Edge]],
    length: Callable[[Edge], float],
    at_most: float = np.inf,
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
        for edge in around.get(place, ()):
            next_place, there = edge.other(place), so_far + length(edge)
            if there <= at_most and there < far.get(next_place, np.inf):
                far[next_place] = there
                heapq.heappush(waiting, (there, next_place))
    return np.inf

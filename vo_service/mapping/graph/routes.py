"""What is connected in a graph of places, and how far apart."""

import heapq
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from vo_service.mapping.graph.edges import Edge


def neighbours(edges: Iterable[Edge]) -> Mapping[int, list[Edge]]:
    """The edges at each place that has any."""
    found: defaultdict[int, list[Edge]] = defaultdict(list)
    for edge in edges:
        found[edge.a].append(edge)
        found[edge.b].append(edge)
    return found


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
    start: int, goal: int, edges: Iterable[Edge], length: Callable[[Edge], float]
) -> float:
    """Length of the shortest way over the edges; infinite where there is none.

    Dijkstra, "A note on two problems in connexion with graphs" (1959).
    """
    around = neighbours(edges)
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
            if there < far.get(next_place, np.inf):
                far[next_place] = there
                heapq.heappush(waiting, (there, next_place))
    return np.inf

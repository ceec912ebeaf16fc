"""How edges are passed on when a place is forgotten."""

from collections.abc import Mapping, Sequence

import numpy as np

from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.routes import shortest


def passed_on(number: int, edges: Sequence[Edge]) -> list[Edge]:
    """What the edges of this place say of the others, motions first, then loops, the surest first.

    One neighbour inherits: every other edge now starts from there, by way of what joined the two.
    A motion makes a better heir than a loop, which may be wrong; then the surest does.
    """
    way = way_to_heir(number, edges)
    if way is None:
        return []
    from_heir = way.starting_at(way.b)
    its = (edge.starting_at(number) for edge in edges if number in (edge.a, edge.b))
    return sorted((from_heir.then(edge) for edge in its if edge.b != way.b), key=_rank)


def way_to_heir(number: int, edges: Sequence[Edge]) -> Edge | None:
    """The edge from this place to the one that inherits; None where nothing joins it to others."""
    its = (edge.starting_at(number) for edge in edges if number in (edge.a, edge.b))
    return min(its, key=_rank, default=None)


def tells_something_new(loop: Edge, around: Mapping[int, list[Edge]]) -> bool:
    """True if no way over the edges around the places (see `neighbours`) is as sure as the loop.

    Of the loops that are passed on again and again, only these are kept: else there would be more
    and more of them.
    """
    own_m2 = loop.spread_m2
    return shortest(loop.a, loop.b, around, lambda edge: edge.spread_m2, own_m2) == np.inf


def _rank(edge: Edge) -> tuple[bool, float]:
    return edge.is_loop, edge.spread_m2

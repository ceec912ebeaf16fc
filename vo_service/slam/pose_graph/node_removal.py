"""How edges are passed on when a place is forgotten."""

from collections.abc import Mapping, Sequence

import numpy as np

from vo_service.slam.pose_graph.connectivity import shortest_path_length
from vo_service.slam.pose_graph.edges import Edge


def marginalize_edges(number: int, edges: Sequence[Edge]) -> list[Edge]:
    """What the edges of this place say of the others, motions first, then loops, the surest first.

    One neighbour inherits: every other edge now starts from there, by way of what joined the two.
    A motion makes a better heir than a loop, which may be wrong; then the surest does.
    """
    way = edge_to_neighbor(number, edges)
    if way is None:
        return []
    from_heir = way.oriented_from(way.b)
    its = (edge.oriented_from(number) for edge in edges if number in (edge.a, edge.b))
    return sorted((from_heir.compose(edge) for edge in its if edge.b != way.b), key=_edge_priority)


def edge_to_neighbor(number: int, edges: Sequence[Edge]) -> Edge | None:
    """The edge from this place to the one that inherits; None where nothing joins it to others."""
    its = (edge.oriented_from(number) for edge in edges if number in (edge.a, edge.b))
    return min(its, key=_edge_priority, default=None)


def is_informative(loop: Edge, adjacency: Mapping[int, list[Edge]]) -> bool:
    """True if no way over the edges around the places (see `neighbours`) is as sure as the loop.

    Of the loops that are passed on again and again, only these are kept: else there would be more
    and more of them.
    """
    own_m2 = loop.variance_m2
    return (
        shortest_path_length(loop.a, loop.b, adjacency, lambda edge: edge.variance_m2, own_m2)
        == np.inf
    )


def _edge_priority(edge: Edge) -> tuple[bool, float]:
    return edge.is_loop, edge.variance_m2

"""Edges of the neighbors of a removed node."""

from collections.abc import Mapping, Sequence

import numpy as np

from vo_service.slam.pose_graph.connectivity import shortest_path_length
from vo_service.slam.pose_graph.edges import Edge


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

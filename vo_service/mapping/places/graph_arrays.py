"""The graph of places as named arrays, and back."""

from collections.abc import Sequence, Set

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import Node
from vo_service.mapping.places.array_bytes import ANY_LENGTH, Arrays, require_array, require_poses


def graph_to_arrays(nodes: Sequence[Node], edges: Sequence[Edge]) -> dict[str, NDArray[np.generic]]:
    """In the order in which they are given."""
    return {
        "node/number": np.array([node.number for node in nodes], np.int64),
        "node/world": np.array([node.world_id for node in nodes], np.int64),
        "node/T_world": _stack_matrices([node.T_world_keyframe for node in nodes], 4),
        "node/T_map": _stack_matrices([node.T_map_keyframe for node in nodes], 4),
        "edge/ends": np.array([(edge.a, edge.b) for edge in edges], np.int64).reshape(-1, 2),
        "edge/T": _stack_matrices([edge.T_a_b for edge in edges], 4),
        "edge/covariance": _stack_matrices([edge.covariance for edge in edges], 6),
        "edge/is_loop": np.array([edge.is_loop for edge in edges], np.bool_),
        "edge/length_m": np.array([edge.length_m for edge in edges], np.float64),
    }


def nodes_from_arrays(arrays: Arrays) -> list[Node]:
    """The places in the graph. Raises ValueError for arrays that are not those of a graph."""
    number = require_array(arrays, "node/number", np.int64, (ANY_LENGTH,))
    world = require_array(arrays, "node/world", np.int64, (len(number),))
    T_world = require_poses(arrays, "node/T_world", len(number))
    T_map = require_poses(arrays, "node/T_map", len(number))
    rows = zip(number.tolist(), world.tolist(), T_world, T_map, strict=True)
    return [Node(*row) for row in rows]


def edges_from_arrays(arrays: Arrays, numbers: Set[int]) -> list[Edge]:
    """The edges between places of these numbers. Raises ValueError as `nodes_from_arrays`."""
    ends = require_array(arrays, "edge/ends", np.int64, (ANY_LENGTH, 2))
    count = len(ends)
    T = require_poses(arrays, "edge/T", count)
    covariance = require_array(arrays, "edge/covariance", np.float64, (count, 6, 6))
    is_loop = require_array(arrays, "edge/is_loop", np.bool_, (count,))
    length_m = require_array(arrays, "edge/length_m", np.float64, (count,))
    if not set(ends.ravel().tolist()) <= numbers or np.any(ends[:, 0] == ends[:, 1]):
        raise ValueError("has edges to places that are not there")
    if np.any(length_m < 0) or not _are_positive_definite(covariance):
        raise ValueError("has edges that cannot be")
    rows = zip(*ends.T.tolist(), T, covariance, is_loop.tolist(), length_m.tolist(), strict=True)
    return [Edge(*row) for row in rows]


def _are_positive_definite(covariance: Array) -> bool:
    """Whether matrices (N, 6, 6) are symmetric, but for rounding, and positive definite."""
    if len(covariance) == 0:
        return True
    uneven = np.abs(covariance - covariance.transpose(0, 2, 1)).max(axis=(1, 2))
    sizes = np.abs(covariance).max(axis=(1, 2))
    return bool(np.all(uneven <= 1e-6 * sizes) and np.linalg.eigvalsh(covariance).min() > 0.0)


def _stack_matrices(matrices: Sequence[Array], side: int) -> Array:
    return np.array(matrices, np.float64).reshape(-1, side, side)

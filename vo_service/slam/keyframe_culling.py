"""Keyframe culling: the most redundant keyframes are removed from the map."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.slam.graph_edges import Edge
from vo_service.slam.keyframe_database import KeyframeDatabase, MapKeyframe
from vo_service.slam.keyframe_selection import pose_distance_steps
from vo_service.slam.pose_graph import NodeRemoval, PoseGraph

# Distance of two keyframes: the sum of their distance and their angle, in these units.
DISTANCE_SCALE_M, DISTANCE_SCALE_RAD = 0.3, np.radians(20.0)


def find_most_redundant(T_map_keyframe: Array, component: NDArray[np.int64]) -> int:
    """Find the keyframe that is nearest to others of its component.

    Of the two that are nearest to each other it is the one that is nearer to a third.

    Args:
        T_map_keyframe: (N, 4, 4) in chronological order.
        component: (N,) index of each keyframe's connected component.

    Returns:
        Its row; never the first or the last one.

    Raises:
        ValueError: There are fewer than three keyframes.
    """
    count = len(T_map_keyframe)
    if count < 3:
        raise ValueError("the first and the newest keyframe are never culled")
    distances = _pairwise_distances(T_map_keyframe)
    distances[component[:, None] != component[None, :]] = np.inf
    np.fill_diagonal(distances, np.inf)
    two_nearest = np.partition(distances, 1, axis=1)[:, :2]
    return min(range(1, count - 1), key=lambda n: tuple(two_nearest[n]))


def _pairwise_distances(T: Array) -> Array:
    """(N, N) distances of poses, in the units above."""
    position_m, squared_m2 = T[:, :3, 3], np.sum(T[:, :3, 3] ** 2, axis=1)
    squared_distance_m2 = squared_m2[:, None] + squared_m2 - 2.0 * position_m @ position_m.T
    rows = T[:, :3, :3].reshape(len(T), 9)
    cosine = np.clip((rows @ rows.T - 1.0) / 2.0, -1.0, 1.0)
    distances: Array = (
        np.sqrt(np.maximum(squared_distance_m2, 0.0)) / DISTANCE_SCALE_M
        + np.arccos(cosine) / DISTANCE_SCALE_RAD
    )
    return distances


# A loop closure over no more steps, of 15 cm or 10 degrees, makes the keyframe a duplicate.
MAX_DUPLICATE_STEPS = 1.5
# Fewest keyframes, whatever their size.
MIN_KEYFRAMES = 3


class KeyframeCuller:
    """Remove keyframes from a map; their edges are passed on in its graph."""

    def __init__(self, database: KeyframeDatabase, graph: PoseGraph) -> None:
        self._database = database
        self._graph = graph
        # To the newest keyframe, if that is a duplicate.
        self._duplicate_edge: Edge | None = None

    def cull(self, keyframe: MapKeyframe, loops: Sequence[Edge]) -> list[NodeRemoval]:
        """Remove duplicates, and the most redundant keyframes if the database is too large.

        The newest keyframe always stays, as the next poses are relative to it.

        Returns:
            The removed nodes.
        """
        removals: list[NodeRemoval] = []
        if self._duplicate_edge is not None:
            self._database.remove(self._duplicate_edge.b)
            removals.append(self._graph.remove_redundant_node(self._duplicate_edge))
        self._duplicate_edge = _find_duplicate_edge(keyframe, loops)
        while self._database.is_over_capacity and len(self._database) >= MIN_KEYFRAMES:
            number = self._most_redundant_number()
            self._database.remove(number)
            removals.append(self._graph.remove_node(number))
        return removals

    def _most_redundant_number(self) -> int:
        numbers = list(self._graph.nodes)
        component_of = {
            number: n
            for n, component in enumerate(self._graph.connected_components())
            for number in component
        }
        T_map_keyframe = np.array([self._graph.T_map_keyframe(number) for number in numbers])
        return numbers[
            find_most_redundant(T_map_keyframe, np.array([component_of[n] for n in numbers]))
        ]


def _find_duplicate_edge(keyframe: MapKeyframe, loops: Sequence[Edge]) -> Edge | None:
    """The loop closure of the keyframe with one nearby, if there is one."""
    own_loops = [loop for loop in loops if loop.b == keyframe.number]
    nearby = [
        loop
        for loop in own_loops
        if pose_distance_steps(np.eye(4), loop.T_a_b) < MAX_DUPLICATE_STEPS
    ]
    return nearby[0] if nearby else None

"""Which place of a map can best be spared: one that its neighbours tell as well."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.slam.keyframe_selector import pose_distance_steps
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.pose_graph.edges import Edge
from vo_service.slam.pose_graph.pose_graph import NodeRemoval, PoseGraph

# Two places are as near as the sum of the way between them and of the turn, in these units.
DISTANCE_SCALE_M, DISTANCE_SCALE_RAD = 0.3, np.radians(20.0)


def find_most_redundant(T_map_keyframe: Array, component: NDArray[np.int64]) -> int:
    """Row of the place that can best be spared: one that is near to others of its part.

    Of two that are nearest to each other it is the one that is nearer to a third. The first and
    the last row are never spared. Raises ValueError with fewer than three places.

    T_map_place  (N, 4, 4), in the order in which they were seen
    part         (N,) what of the map a place is connected with: elsewhere nothing is near
    """
    count = len(T_map_keyframe)
    if count < 3:
        raise ValueError("the first and the newest place are never spared")
    apart = _pairwise_distances(T_map_keyframe)
    apart[component[:, None] != component[None, :]] = np.inf
    np.fill_diagonal(apart, np.inf)
    two_nearest = np.partition(apart, 1, axis=1)[:, :2]
    return min(range(1, count - 1), key=lambda n: tuple(two_nearest[n]))


def _pairwise_distances(T: Array) -> Array:
    """(N, N) how far poses are from each other, in the units above."""
    at_m, squared_m2 = T[:, :3, 3], np.sum(T[:, :3, 3] ** 2, axis=1)
    way_m2 = squared_m2[:, None] + squared_m2 - 2.0 * at_m @ at_m.T
    rows = T[:, :3, :3].reshape(len(T), 9)
    cosine = np.clip((rows @ rows.T - 1.0) / 2.0, -1.0, 1.0)
    apart: Array = (
        np.sqrt(np.maximum(way_m2, 0.0)) / DISTANCE_SCALE_M + np.arccos(cosine) / DISTANCE_SCALE_RAD
    )
    return apart


# A place that shows another from no more steps away, of 15 cm or 10 degrees, is no other place.
MAX_DUPLICATE_STEPS = 1.5
# Of fewer places than these none is spared, whatever they take.
MIN_KEYFRAMES = 3


class KeyframeCuller:
    """Leaves places out of a map; what they were joined by is passed on in its graph."""

    def __init__(self, database: KeyframeDatabase, graph: PoseGraph) -> None:
        self._database = database
        self._graph = graph
        self._duplicate_edge: Edge | None = (
            None  # to the newest place, where that tells nothing new
        )

    def cull(self, keyframe: MapKeyframe, loops: Sequence[Edge]) -> list[NodeRemoval]:
        """Those that go now that there is a new place; `loops` are those that it has closed.

        The newest always stays: the poses that come next are told from there.
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
        part_of = {
            number: n
            for n, part in enumerate(self._graph.connected_components())
            for number in part
        }
        T_map_place = np.array([self._graph.T_map_keyframe(number) for number in numbers])
        return numbers[find_most_redundant(T_map_place, np.array([part_of[n] for n in numbers]))]


def _find_duplicate_edge(keyframe: MapKeyframe, loops: Sequence[Edge]) -> Edge | None:
    """The loop of the place from one nearby, which has told all that it tells."""
    own = [loop for loop in loops if loop.b == keyframe.number]
    near = [
        loop for loop in own if pose_distance_steps(np.eye(4), loop.T_a_b) < MAX_DUPLICATE_STEPS
    ]
    return near[0] if near else None

"""Which places go again: the map grows with what was seen, not with time, and no further."""

from collections.abc import Sequence

import numpy as np

from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import NodeRemoval, PoseGraph
from vo_service.mapping.places.place import MapKeyframe
from vo_service.mapping.places.places import KeyframeDatabase
from vo_service.mapping.places.redundancy import find_most_redundant
from vo_service.mapping.spacing import pose_distance_steps

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

"""Which places go again: the map grows with what was seen, not with time, and no further."""

from collections.abc import Sequence

import numpy as np

from vo_service.mapping.graph.edges import Edge
from vo_service.mapping.graph.pose_graph import PoseGraph, Removal
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.redundancy import most_redundant
from vo_service.mapping.spacing import steps_between

# A place that shows another from no more steps away, of 15 cm or 10 degrees, is no other place.
REPEATED_STEPS = 1.5
# Of fewer places than these none is spared, whatever they take.
FEWEST_PLACES = 3


class Thinning:
    """Leaves places out of a map; what they were joined by is passed on in its graph."""

    def __init__(self, places: Places, graph: PoseGraph) -> None:
        self._places = places
        self._graph = graph
        self._repeated: Edge | None = None  # to the newest place, where that tells nothing new

    def after(self, place: Place, loops: Sequence[Edge]) -> list[Removal]:
        """Those that go now that there is a new place; `loops` are those that it has closed.

        The newest always stays: the poses that come next are told from there.
        """
        removals: list[Removal] = []
        if self._repeated is not None:
            self._places.remove(self._repeated.b)
            removals.append(self._graph.leave_out(self._repeated))
        self._repeated = _repeated(place, loops)
        while self._places.is_over and len(self._places) >= FEWEST_PLACES:
            number = self._redundant()
            self._places.remove(number)
            removals.append(self._graph.remove(number))
        return removals

    def _redundant(self) -> int:
        numbers = list(self._graph.nodes)
        part_of = {number: n for n, part in enumerate(self._graph.parts()) for number in part}
        T_map_place = np.array([self._graph.T_map(number) for number in numbers])
        return numbers[most_redundant(T_map_place, np.array([part_of[n] for n in numbers]))]


def _repeated(place: Place, loops: Sequence[Edge]) -> Edge | None:
    """The loop of the place from one nearby, which has told all that it tells."""
    own = [loop for loop in loops if loop.b == place.number]
    near = [loop for loop in own if steps_between(np.eye(4), loop.T_a_b) < REPEATED_STEPS]
    return near[0] if near else None

"""Which places a new view may show: those that look like it, and those that should be there."""

from collections import deque

import numpy as np

from drivers.geometry import Array
from vo_service.mapping.graph.pose_graph import PoseGraph
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.view import PlaceView
from vo_service.mapping.spacing import steps_between

# The last places of the way are no loop: the odometry was laid on them itself.
RECENT = 8
# So many places are looked at closely: those that look most alike, and those nearest to where the
# camera should be.
ALIKE, IN_VIEW = 5, 2
# A place should be in view from so many steps away.
IN_VIEW_STEPS = 4.0


class Candidates:
    """Chooses among places."""

    def __init__(self, places: Places, graph: PoseGraph) -> None:
        self._places = places
        self._graph = graph
        self._recent: deque[int] = deque(maxlen=RECENT)
        self._world: int | None = None  # of these

    def passed(self, place: Place) -> None:
        """The camera has come by this place."""
        self._recent.append(place.number)

    def alike(self, view: PlaceView) -> list[Place]:
        """Those that look like a view, the most alike first."""
        return self._places.alike(view, ALIKE, lambda place: True)

    def of_a_loop(self, view: PlaceView, world: int, T_map_camera: Array) -> list[Place]:
        """Those that would be a loop, for a view in a world, from where the graph has it."""
        if world != self._world:
            self._world = world
            self._recent.clear()
        found = self._places.alike(view, ALIKE, self._is_old)
        known = {place.number for place in found}
        return found + [each for each in self._in_view(T_map_camera) if each.number not in known]

    def _in_view(self, T_map_camera: Array) -> list[Place]:
        old = [place for place in self._places if self._is_old(place)]
        if not old:
            return []
        T_map_places = np.array([self._graph.T_map(place.number) for place in old])
        steps = steps_between(T_map_camera, T_map_places)
        nearest = np.argsort(steps, kind="stable")[:IN_VIEW]
        return [old[index] for index in nearest if steps[index] <= IN_VIEW_STEPS]

    def _is_old(self, place: Place) -> bool:
        return place.number not in self._recent

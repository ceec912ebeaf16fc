"""Where a camera was, as seen from a place: it moves along when the map is corrected."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from drivers.geometry import Array

if TYPE_CHECKING:  # its libraries are slow to load
    from vo_service.mapping.graph.pose_graph import Removal


@dataclass(frozen=True, eq=False)
class FromPlace:
    """A pose of the camera.

    place           number of the last place before it; None where there is none
    T_place_camera  4x4, from there; from the map where there is none
    """

    place: int | None
    T_place_camera: Array

    def carried_over(self, removal: "Removal") -> "FromPlace":
        """The same when a place is no more: its own is told from a neighbour of that."""
        if self.place != removal.number:
            return self
        return FromPlace(removal.neighbour, removal.T_neighbour_removed @ self.T_place_camera)

    def in_map(self, T_map: Callable[[int], Array]) -> Array:
        """4x4 T_map_camera, the places being where `T_map` says."""
        if self.place is None:
            return self.T_place_camera
        return np.asarray(T_map(self.place) @ self.T_place_camera)

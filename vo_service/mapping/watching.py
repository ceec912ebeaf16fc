"""What a preview of a growing map shows."""

from dataclasses import dataclass
from typing import Protocol

from drivers.camera import PinholeCamera
from drivers.geometry import Array
from vo_service.mapping.mesh import Mesh


@dataclass(frozen=True)
class MapSoFar:
    """The surface, and where the camera has been: (N, 3) in the world."""

    mesh: Mesh
    path_m: Array


@dataclass(frozen=True)
class Sight:
    """What there is after the frame `seq`: the same `so_far` as before, or a new one."""

    seq: int
    camera: PinholeCamera
    T_world_camera: Array
    so_far: MapSoFar


class MapView(Protocol):
    """One place where the map is shown."""

    def show(self, item: Sight) -> None:
        """Show it, soon."""
        ...

"""What a preview of a growing map shows."""

from dataclasses import dataclass
from typing import Protocol

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.reconstruction.mesh import Mesh


@dataclass(frozen=True)
class PreviewMap:
    """The surface, and where the camera has been: (N, 3) in the world."""

    mesh: Mesh
    trajectory_m: Array


@dataclass(frozen=True)
class PreviewFrame:
    """What there is after the frame `seq`: the same `preview_map` as before, or a new one."""

    seq: int
    camera: PinholeCamera
    T_world_camera: Array
    preview_map: PreviewMap


class Preview(Protocol):
    """One place where the map is shown."""

    def show(self, item: PreviewFrame) -> None:
        """Show it, soon."""
        ...

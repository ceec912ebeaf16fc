"""Preview of a growing map."""

from dataclasses import dataclass
from typing import Protocol

from drivers.camera import PinholeCamera
from drivers.core.geometry import Array
from vo_service.reconstruction.mesh import Mesh


@dataclass(frozen=True)
class PreviewMap:
    """The surface, and the camera's positions (N, 3) in the world."""

    mesh: Mesh
    trajectory_m: Array


@dataclass(frozen=True)
class PreviewFrame:
    """The camera after the frame `seq`, with the same `preview_map` as before or a new one."""

    seq: int
    camera: PinholeCamera
    T_world_camera: Array
    preview_map: PreviewMap


class Preview(Protocol):
    """One preview of the map."""

    def show(self, item: PreviewFrame) -> None:
        """Queue a frame."""
        ...

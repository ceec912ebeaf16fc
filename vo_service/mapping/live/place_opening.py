"""Opening what knows places, or what stands in for it where there is none."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from drivers.geometry import Array
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import Tell
from vo_service.mapping.loops.from_place import FromPlace
from vo_service.recorder.shared_ring import Record
from vo_service.settings import MapSettings

if TYPE_CHECKING:  # its libraries take a second and a hundred megabytes
    from vo_service.mapping.graph.pose_graph import Removal
    from vo_service.mapping.live.place_desk import PlaceDesk


class NoPlaceDesk:
    """Where no places are remembered."""

    def take_in(self, record: Record) -> "Sequence[Removal]":
        """It is a keyframe alone."""
        return ()

    def answer(self) -> None:
        """Nobody asks."""

    def save(self, folder: MapsFolder, name: str, total_bytes: int) -> None:
        """There are none."""

    def load(self, file: Path) -> int:
        """Never possible. Raises InputError."""
        raise InputError(f"{file}: no places are remembered (map.loops)")

    def from_last(self, T_odom_camera: Array) -> FromPlace:
        """There is none: the map is `odom`."""
        return FromPlace(None, T_odom_camera)

    def T_map_camera(self, pose: FromPlace) -> Array:
        """As it is."""
        return pose.T_place_camera


def open_place_desk(settings: MapSettings, tell: Tell) -> "PlaceDesk | NoPlaceDesk":
    """What the settings ask for."""
    if not settings.loops:
        return NoPlaceDesk()
    from vo_service.mapping.live.place_desk import PlaceDesk

    return PlaceDesk(settings, tell)

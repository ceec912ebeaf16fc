"""Opening what knows places, or what stands in for it where there is none."""

from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from drivers.geometry import Array
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import Tell
from vo_service.recorder.shared_ring import Record
from vo_service.settings import MapSettings

if TYPE_CHECKING:  # its libraries take a second and a hundred megabytes
    from vo_service.mapping.live.place_desk import PlaceDesk


class NoPlaceDesk:
    """Where no places are remembered."""

    last_place = None

    def take_in(self, record: Record) -> None:
        """It is a keyframe alone."""

    def answer(self) -> None:
        """Nobody asks."""

    def save(self, folder: MapsFolder, name: str, total_bytes: int) -> None:
        """There are none."""

    def load(self, file: Path) -> int:
        """Never possible. Raises InputError."""
        raise InputError(f"{file}: no places are remembered (map.loops)")

    def T_map_camera(self, place: int | None, T_odom_camera: Array) -> Array:
        """The map is `odom`."""
        return T_odom_camera


def open_place_desk(settings: MapSettings, tell: Tell) -> "PlaceDesk | NoPlaceDesk":
    """What the settings ask for."""
    if not settings.loops:
        return NoPlaceDesk()
    from vo_service.mapping.live.place_desk import PlaceDesk

    return PlaceDesk(settings, tell)

"""What the service and the mapper's process say to each other; frames go through the ring."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.core.process.messages import Heartbeat, LogMessage, Shutdown
from drivers.core.shared_frames.record_ring import RecordRingMemory
from vo_service.config_tables import MapConfig
from vo_service.odometry.relocalization import RelocalizationResult
from vo_service.types import MapSnapshot


@dataclass(frozen=True)
class MapperWorkerConfig:
    """To the mapper, first and once.

    frames     the ring that keyframes come through
    first      number of the first of them that counts
    maps       folder of the maps
    log_level  of the service's log
    """

    frame_ring: RecordRingMemory
    first_frame: int
    maps_folder: Path
    map_config: MapConfig
    log_level: int

    @property
    def fds(self) -> tuple[int, ...]:
        """The ring."""
        return (self.frame_ring.fd,)


@dataclass(frozen=True)
class RelocalizationQuery:
    """In the note of a frame in the ring, to ask where it was taken.

    A frame whose note has a `OdometryConstraint` is to be a place; one with neither is a keyframe
    alone.
    """


@dataclass(frozen=True)
class SaveMapRequest:
    """To the mapper: make a map of what there is now, and write it under this name."""

    name: str


@dataclass(frozen=True)
class LoadMapRequest:
    """To the mapper: forget all places, and know those of the map of this name."""

    name: str


MapperRequest = SaveMapRequest | LoadMapRequest | MapConfig | Shutdown


@dataclass(frozen=True)
class MapperStatus(Heartbeat):
    """From the mapper, every second and after each keyframe.

    keyframes  how many it has
    maps       names that are taken
    places     names of the maps whose places can be loaded
    trouble    why nothing can be kept in the folder; "" while all is well
    """

    keyframe_count: int
    map_names: frozenset[str]
    loadable_names: frozenset[str]
    error: str = ""


@dataclass(frozen=True)
class SaveMapResult:
    """From the mapper: how a `SaveMap` ended. `trouble` is "" if the file is there.

    is_cut_off  True if there was not enough memory for all that was seen
    """

    file: Path
    keyframe_count: int = 0
    triangle_count: int = 0
    is_truncated: bool = False
    error: str = ""


@dataclass(frozen=True)
class LoadMapResult:
    """From the mapper: how a `LoadMap` ended. `trouble` is "" if its places are known now."""

    file: Path
    keyframe_count: int = 0
    error: str = ""


# A snapshot comes when the map has changed, a place where a frame was taken when that is known.
MapperMessage = (
    MapperStatus | SaveMapResult | LoadMapResult | MapSnapshot | RelocalizationResult | LogMessage
)
SendMapperMessage = Callable[[MapperMessage], object]

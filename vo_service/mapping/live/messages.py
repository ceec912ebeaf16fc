"""What the service and the mapper's process say to each other; frames go through the ring."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.isolation.messages import LogLine
from vo_service.background.messages import End, SignOfLife
from vo_service.odometry.relocalising import Located
from vo_service.recorder.shared_ring import RingMemory
from vo_service.settings import MapSettings
from vo_service.types import MapSnapshot


@dataclass(frozen=True)
class Job:
    """To the mapper, first and once.

    frames     the ring that keyframes come through
    first      number of the first of them that counts
    maps       folder of the maps
    log_level  of the service's log
    """

    frames: RingMemory
    first: int
    maps: Path
    settings: MapSettings
    log_level: int

    @property
    def fds(self) -> tuple[int, ...]:
        """The ring."""
        return (self.frames.fd,)


@dataclass(frozen=True)
class Asked:
    """In the note of a frame in the ring, to ask where it was taken.

    A frame whose note has a `Hop` is to be a place; one with neither is a keyframe alone.
    """


@dataclass(frozen=True)
class SaveMap:
    """To the mapper: make a map of what there is now, and write it under this name."""

    name: str


@dataclass(frozen=True)
class LoadMap:
    """To the mapper: forget all places, and know those of the map of this name."""

    name: str


Order = SaveMap | LoadMap | MapSettings | End


@dataclass(frozen=True)
class Facts(SignOfLife):
    """From the mapper, every second and after each keyframe.

    keyframes  how many it has
    maps       names that are taken
    places     names of the maps whose places can be loaded
    trouble    why nothing can be kept in the folder; "" while all is well
    """

    keyframes: int
    maps: frozenset[str]
    places: frozenset[str]
    trouble: str = ""


@dataclass(frozen=True)
class MapEnded:
    """From the mapper: how a `SaveMap` ended. `trouble` is "" if the file is there.

    is_cut_off  True if there was not enough memory for all that was seen
    """

    file: Path
    keyframes: int = 0
    triangles: int = 0
    is_cut_off: bool = False
    trouble: str = ""


@dataclass(frozen=True)
class MapLoaded:
    """From the mapper: how a `LoadMap` ended. `trouble` is "" if its places are known now."""

    file: Path
    places: int = 0
    trouble: str = ""


# A snapshot comes when the map has changed, a place where a frame was taken when that is known.
Word = Facts | MapEnded | MapLoaded | MapSnapshot | Located | LogLine
Tell = Callable[[Word], object]

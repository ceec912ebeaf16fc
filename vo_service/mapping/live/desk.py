"""What the mapper's process does when it is told to, and with what comes through the ring."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers.errors import InputError, UserFacingError
from drivers.full_disk import obstacle
from vo_service.mapping.live.keyframes import Keyframe, Keyframes
from vo_service.mapping.live.making import Making, make_map
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import (
    Facts,
    Job,
    LoadMap,
    MapEnded,
    MapLoaded,
    SaveMap,
    Tell,
)
from vo_service.mapping.live.place_opening import open_place_desk
from vo_service.recorder.frame_record import note_of
from vo_service.recorder.shared_ring import Record, RingReader
from vo_service.settings import MEGABYTE, MapSettings
from vo_service.types import TrackingState


class Desk:
    """Keeps the keyframes, and has a map made of them, one at a time."""

    def __init__(self, job: Job, tell: Tell, leave: Callable[[], None]) -> None:
        """`leave` is called in each process that makes a map, to let go of what is ours."""
        self._settings, self._tell, self._leave = job.settings, tell, leave
        self._ring, self._next = RingReader(job.frames), job.first
        self._keyframes = Keyframes(job.settings.max_mb * MEGABYTE)
        self._folder = MapsFolder(job.maps)
        self._places = open_place_desk(job.settings, tell)
        self._making: list[Making] = []  # one at most
        with suppress(OSError):  # the facts tell what is wrong with the folder
            self._folder.clean_up()
        if job.settings.load is not None:
            self._load(job.settings.load)

    @property
    def facts(self) -> Facts:
        """What is told every second."""
        names = with_places = frozenset[str]()
        with suppress(OSError):  # it is the trouble
            names, with_places = self._folder.names, self._folder.names_with_places
        return Facts(len(self._keyframes), names, with_places, obstacle(self._folder.folder))

    @property
    def sources(self) -> "list[Connection[Any, Any]]":
        """Of which one is ready when a map has ended."""
        return [making.source for making in self._making]

    def take_in(self) -> bool:
        """Take the frames that have come, and answer what was asked; whether there were any."""
        end = self._ring.count
        begin, self._next = max(self._next, self._ring.oldest), end
        for number in range(begin, end):
            record = self._ring.record(number)
            if record is not None:  # else they came too fast: the next is not far
                self._take_in(record)
        self._places.answer()
        return begin < end

    def take(self, order: SaveMap | LoadMap | MapSettings) -> None:
        """Begin what is ordered; how it ends is told."""
        match order:
            case SaveMap(name):
                self._save(name)
            case LoadMap(name):
                self._load(name)
            case MapSettings():
                self._settings = order
                self._keyframes.hold_at_most(order.max_mb * MEGABYTE)

    def tell_ended(self) -> None:
        """Tell of a map that has ended; waits for it."""
        while self._making:
            self._tell(self._making.pop().ended())

    def give_up(self) -> None:
        """End what is being made, and leave nothing of it."""
        while self._making:
            self._making.pop().give_up()
        with suppress(OSError):
            self._folder.clean_up()

    def _take_in(self, record: Record) -> None:
        for removal in self._places.take_in(record):
            self._keyframes.carry_over(removal)
        said = note_of(record.note).said
        is_sure = said.state is TrackingState.TRACKING  # else it was only asked about
        if is_sure and self._keyframes.wants(said.epoch, said.T_world_camera):
            self._keyframes.add(Keyframe.of(record, self._places.from_last(said.T_world_camera)))

    def _load(self, name: str) -> None:
        """Know the places of a map. Keyframes of before lie in a map that is no more."""
        file = self._folder.places_file(name)
        try:
            places = self._places.load(file)
        except InputError as error:
            self._tell(MapLoaded(file, trouble=str(error)))
            return
        self._keyframes.forget()
        self._tell(MapLoaded(file, places))

    def _save(self, name: str) -> None:
        """Write the places, and begin to make the surface."""
        file = self._folder.file(name)
        try:
            self._places.save(self._folder, name, self._settings.total_mb * MEGABYTE)
        except UserFacingError as error:
            self._tell(MapEnded(file, trouble=str(error)))
            return
        self._make(name)

    def _make(self, name: str) -> None:
        file = self._folder.file(name)
        keyframes = [
            replace(each, T_odom_camera=self._places.T_map_camera(each.from_place))
            for each in self._keyframes
        ]
        if not keyframes:
            self._tell(MapEnded(file, trouble=f"{file}: there is no keyframe yet"))
            return
        make = partial(make_map, self._folder, name, keyframes, self._settings)
        try:
            self._making.append(Making(file, make, self._leave))
        except OSError as error:
            self._tell(MapEnded(file, trouble=f"{file}: cannot be begun: {error.strerror}"))

"""What the mapper's process does when it is told to, and with what comes through the ring."""

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from vo_service.mapping.live.keyframes import Keyframe, Keyframes
from vo_service.mapping.live.making import Making, make_map
from vo_service.mapping.live.maps_folder import MEGABYTE, MapsFolder
from vo_service.mapping.live.messages import Facts, Job, MapEnded, SaveMap, Word
from vo_service.recorder.frame_record import note_of
from vo_service.recorder.incident_folder import obstacle
from vo_service.recorder.shared_ring import Record, RingReader
from vo_service.settings import MapSettings


class Desk:
    """Keeps the keyframes, and has a map made of them, one at a time."""

    def __init__(self, job: Job, tell: Callable[[Word], object], leave: Callable[[], None]) -> None:
        """`leave` is called in each process that makes a map, to let go of what is ours."""
        self._settings, self._tell, self._leave = job.settings, tell, leave
        self._ring, self._next = RingReader(job.frames), job.first
        self._keyframes = Keyframes(job.settings.max_mb * MEGABYTE)
        self._folder = MapsFolder(job.maps)
        self._making: list[Making] = []  # one at most
        with suppress(OSError):  # the facts tell what is wrong with the folder
            self._folder.clean_up()

    @property
    def facts(self) -> Facts:
        """What is told every second."""
        names: frozenset[str] = frozenset()
        with suppress(OSError):  # it is the trouble
            names = self._folder.names
        return Facts(len(self._keyframes), names, obstacle(self._folder.folder))

    @property
    def sources(self) -> "list[Connection[Any, Any]]":
        """Of which one is ready when a map has ended."""
        return [making.source for making in self._making]

    def take_in(self) -> bool:
        """Take the keyframes that have come; whether there were any."""
        end = self._ring.count
        begin, self._next = max(self._next, self._ring.oldest), end
        for number in range(begin, end):
            record = self._ring.record(number)
            if record is not None:  # else they came too fast: the next is not far
                self._take_in(record)
        return begin < end

    def take(self, order: SaveMap | MapSettings) -> None:
        """Begin what is ordered; how a map ends is told."""
        match order:
            case SaveMap(name):
                self._make(name)
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
        said = note_of(record.note).said
        if self._keyframes.wants(said.epoch, said.T_world_camera):
            self._keyframes.add(Keyframe.of(record))

    def _make(self, name: str) -> None:
        file, keyframes = self._folder.file(name), list(self._keyframes)
        if not keyframes:
            self._tell(MapEnded(file, trouble=f"{file}: there is no keyframe yet"))
            return
        make = partial(make_map, self._folder, name, keyframes, self._settings)
        try:
            self._making.append(Making(file, make, self._leave))
        except OSError as error:
            self._tell(MapEnded(file, trouble=f"{file}: cannot be begun: {error.strerror}"))

"""What the map's process does about places: makes them, closes loops, tells where a frame was."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drivers.geometry import Array
from drivers.memory import release_memory
from vo_service.announcements import long_work
from vo_service.mapping.graph.pose_graph import Removal
from vo_service.mapping.live.maps_folder import MapsFolder
from vo_service.mapping.live.messages import Asked, Tell
from vo_service.mapping.loops.from_place import FromPlace
from vo_service.mapping.loops.hop import Hop
from vo_service.mapping.loops.loop_closer import Sight
from vo_service.mapping.loops.opening import closer_in, new_closer
from vo_service.mapping.loops.warm_up import warm_up_loops
from vo_service.mapping.places.map_file import read_map, write_map
from vo_service.recorder.frame_record import frame_of, note_of
from vo_service.recorder.shared_ring import Record
from vo_service.settings import MapSettings


class PlaceDesk:
    """Answers what the notes of frames ask for; their world is `odom`."""

    def __init__(self, settings: MapSettings, tell: Tell) -> None:
        """It loads libraries and compiled kernels, which takes seconds."""
        warm_up_loops(lambda _: None)
        release_memory()  # all kernels are there
        self._settings = settings
        self._closer = new_closer(settings)
        self._tell = tell
        self._asked: Record | None = None

    def take_in(self, record: Record) -> Sequence[Removal]:
        """Make a place of a frame, or remember that it was asked about; which places went."""
        note = note_of(record.note)
        if isinstance(note.more, Asked):
            self._asked = record  # an older one is worth no answer any more
        elif isinstance(note.more, Hop):
            frame, said = frame_of(record, 0.0), note.said
            sight = Sight(frame, said.epoch, said.T_world_camera, note.more)
            change = self._closer.see(sight)
            self._tell(self._closer.snapshot)
            return change.removals
        return ()

    def answer(self) -> None:
        """Tell where the frame was taken that was asked about last, if that is known.

        After a reset `odom` lies elsewhere: until a place was seen in that, nobody can tell.
        """
        record, self._asked = self._asked, None
        if record is None or note_of(record.note).said.epoch != self._closer.world:
            return
        located = self._closer.locate(frame_of(record, 0.0))
        if located is not None:
            self._tell(located)

    def save(self, folder: MapsFolder, name: str, total_bytes: int) -> None:
        """Write all places. Raises UserFacingError."""
        write = partial(write_map, contents=self._closer.contents)
        folder.write(folder.places_file(name), total_bytes, write)

    def load(self, file: Path) -> int:
        """Know the places of a file, and no others; how many. Raises InputError."""
        with long_work(f"loading {file}"):
            self._closer = closer_in(read_map(file), self._settings)
        self._tell(self._closer.snapshot)
        return len(self._closer.places)

    def from_last(self, T_odom_camera: Array) -> FromPlace:
        """A pose as seen from the last place."""
        return self._closer.from_last(T_odom_camera)

    def T_map_camera(self, pose: FromPlace) -> Array:
        """4x4, by what is known now."""
        return pose.in_map(self._closer.graph.T_map)

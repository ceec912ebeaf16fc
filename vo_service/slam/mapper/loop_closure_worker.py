"""What the map's process does about places: makes them, closes loops, tells where a frame was."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from drivers.core.geometry import Array
from drivers.core.memory import release_memory
from drivers.core.shared_frames.record_ring import RingRecord
from vo_service.announcements import announce_if_slow
from vo_service.config_tables import MapConfig
from vo_service.frame_record import decode_frame, decode_metadata
from vo_service.slam.loop_closure.anchored_pose import AnchoredPose
from vo_service.slam.loop_closure.factory import create_loop_closer, create_loop_closer_from_map
from vo_service.slam.loop_closure.loop_closer import KeyframeObservation
from vo_service.slam.loop_closure.odometry_constraint import OdometryConstraint
from vo_service.slam.loop_closure.warm_up import warm_up_loop_closure
from vo_service.slam.mapper.messages import RelocalizationQuery, SendMapperMessage
from vo_service.slam.pose_graph.pose_graph import NodeRemoval
from vo_service.slam.saved_maps.map_file import read_map, write_map
from vo_service.slam.saved_maps.map_store import MapStore


class LoopClosureWorker:
    """Answers what the notes of frames ask for; their world is `odom`."""

    def __init__(self, settings: MapConfig, send: SendMapperMessage) -> None:
        """It loads libraries and compiled kernels, which takes seconds."""
        warm_up_loop_closure(lambda _: None)
        release_memory()  # all kernels are there
        self._settings = settings
        self._loop_closer = create_loop_closer(settings)
        self._send = send
        self._pending_query: RingRecord | None = None

    def process_record(self, record: RingRecord) -> Sequence[NodeRemoval]:
        """Make a place of a frame, or remember that it was asked about; which places went."""
        note = decode_metadata(record.metadata)
        if isinstance(note.extra, RelocalizationQuery):
            self._pending_query = record  # an older one is worth no answer any more
        elif isinstance(note.extra, OdometryConstraint):
            frame, said = decode_frame(record, 0.0), note.published
            sight = KeyframeObservation(frame, said.epoch, said.T_world_camera, note.extra)
            change = self._loop_closer.process_keyframe(sight)
            self._send(self._loop_closer.snapshot)
            return change.removals
        return ()

    def answer_query(self) -> None:
        """Tell where the frame was taken that was asked about last, if that is known.

        After a reset `odom` lies elsewhere: until a place was seen in that, nobody can tell.
        """
        record, self._pending_query = self._pending_query, None
        if (
            record is None
            or decode_metadata(record.metadata).published.epoch != self._loop_closer.world_id
        ):
            return
        located = self._loop_closer.relocalize(decode_frame(record, 0.0))
        if located is not None:
            self._send(located)

    def save(self, store: MapStore, name: str, max_total_bytes: int) -> None:
        """Write all places. Raises UserFacingError."""
        write = partial(write_map, contents=self._loop_closer.contents)
        store.write(store.map_file(name), max_total_bytes, write)

    def load(self, file: Path) -> int:
        """Know the places of a file, and no others; how many. Raises InputError."""
        with announce_if_slow(f"loading {file}"):
            self._loop_closer = create_loop_closer_from_map(read_map(file), self._settings)
        self._send(self._loop_closer.snapshot)
        return len(self._loop_closer.database)

    def anchor_to_last_keyframe(self, T_odom_camera: Array) -> AnchoredPose:
        """A pose as seen from the last place."""
        return self._loop_closer.anchor_to_last_keyframe(T_odom_camera)

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """4x4, by what is known now."""
        return pose.to_map(self._loop_closer.graph.T_map_keyframe)

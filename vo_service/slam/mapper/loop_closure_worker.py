"""Loop closure in the mapper process: keyframes, loops and relocalization."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from drivers.core.geometry import Array
from drivers.core.process.record_ring import RingRecord
from vo_service.config_tables import MapConfig
from vo_service.frame_record import decode_frame, decode_metadata
from vo_service.slam.keyframe_selection import OdometryConstraint
from vo_service.slam.loop_closer import KeyframeObservation
from vo_service.slam.map_cells import MapCells
from vo_service.slam.map_file import MapContents, read_map, write_map
from vo_service.slam.mapper.map_store import MapStore
from vo_service.slam.mapper.messages import RelocalizationQuery, SendMapperMessage
from vo_service.slam.pose_graph import AnchoredPose, NodeRemoval
from vo_service.slam.synchronous_loop_closure import (
    create_loop_closer,
    create_loop_closer_from_map,
    warm_up_loop_closure,
)
from vo_service.terminal import announce_if_slow


class LoopClosureWorker:
    """Processes frames of the ring by their attachment; their world frame is `odom`."""

    def __init__(self, settings: MapConfig, send: SendMapperMessage) -> None:
        """Load libraries and kernels, which takes seconds."""
        warm_up_loop_closure(lambda _: None)
        self._settings = settings
        self._loop_closer = create_loop_closer(settings)
        self._send = send
        self._pending_query: RingRecord | None = None

    def process_record(self, record: RingRecord) -> Sequence[NodeRemoval]:
        """Add a keyframe, or store a query; return the removed nodes."""
        metadata = decode_metadata(record.metadata)
        if isinstance(metadata.extra, RelocalizationQuery):
            self._pending_query = record  # it replaces an older one
        elif isinstance(metadata.extra, OdometryConstraint):
            frame, published = decode_frame(record, 0.0), metadata.published
            observation = KeyframeObservation(
                frame, published.epoch, published.T_world_camera, metadata.extra
            )
            map_update = self._loop_closer.process_keyframe(observation)
            self._send(self._loop_closer.snapshot)
            return map_update.removals
        return ()

    def answer_query(self) -> None:
        """Relocalize the frame of the last query, and send the result.

        After a reset the pose of `odom` in the map is unknown until the epoch has a keyframe.
        """
        record, self._pending_query = self._pending_query, None
        if (
            record is None
            or decode_metadata(record.metadata).published.epoch != self._loop_closer.world_id
        ):
            return
        result = self._loop_closer.relocalize(decode_frame(record, 0.0))
        if result is not None:
            self._send(result)

    @property
    def is_localized(self) -> bool:
        """Whether the current world frame is connected with the oldest keyframe."""
        return self._loop_closer.is_localized

    def save(self, store: MapStore, name: str, max_total_bytes: int, cells: MapCells) -> None:
        """Write the map, with the cells of its occupancy grid.

        Raises:
            UserFacingError: If that fails.
        """
        contents = replace(self._loop_closer.contents, cells=cells)
        write = partial(write_map, contents=contents)
        store.write(store.map_file(name), max_total_bytes, write)

    def load(self, file: Path) -> MapContents:
        """Replace the map by that of a file, and return it.

        Raises:
            InputError: If it is not valid.
        """
        with announce_if_slow(f"loading {file}"):
            contents = read_map(file)
            self._loop_closer = create_loop_closer_from_map(contents, self._settings)
        self._send(self._loop_closer.snapshot)
        return contents

    def anchor_to_last_keyframe(self, T_odom_camera: Array) -> AnchoredPose:
        return self._loop_closer.anchor_to_last_keyframe(T_odom_camera)

    def T_map_camera(self, pose: AnchoredPose) -> Array:
        """4x4 pose in the current map."""
        return pose.to_map(self._loop_closer.graph.T_map_keyframe)

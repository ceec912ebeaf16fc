"""The map as the service sees it: an output that passes keyframes and places on."""

import logging
from dataclasses import replace
from pathlib import Path

from drivers.core.queues import DropOldestQueue, WorkerThread
from drivers.core.shared_frames.depth_packing import compile_kernels, pack_depth
from drivers.core.shared_frames.record_ring import RecordRingWriter
from vo_service.config_tables import MapConfig
from vo_service.frame_record import write_frame
from vo_service.slam.keyframe_selector import KeyframeSelector
from vo_service.slam.loop_closure.odometry_constraint import (
    ConstraintAccumulator,
    NullConstraintAccumulator,
    OdometryConstraint,
)
from vo_service.slam.mapper.asynchronous_loop_closure import AsynchronousLoopClosure
from vo_service.slam.mapper.mapper_client import MapperClient
from vo_service.slam.mapper.messages import MapperWorkerConfig, RelocalizationQuery
from vo_service.types import LoopClosure, MapState, NullLoopClosure, OdometryUpdate, Status

logger = logging.getLogger(__name__)

# The process takes keyframes out several times a second: so much is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_CLOSE_TIMEOUT_S = 1.0


# A frame on its way to the process, and what goes with it into its note.
_QueueItem = tuple[OdometryUpdate, OdometryConstraint | RelocalizationQuery | None]


class LiveMapper:
    """Frames go through shared memory to a process that keeps them, knows them again, makes maps.

    The loop only compares two poses; a thread copies the images of a frame.
    """

    def __init__(self, settings: MapConfig, maps_folder: Path) -> None:
        """Start. `maps` is the folder of the maps. Raises OSError if the memory cannot be had."""
        self._keyframe_selector = KeyframeSelector()
        self._constraints = (
            ConstraintAccumulator() if settings.loop_closure else NullConstraintAccumulator()
        )
        self._memory_fault = ""
        self._is_closed = False
        compile_kernels()
        self._ring = RecordRingWriter("map-keyframes", _RING_S, _RING_BYTES)
        level = logging.getLogger().getEffectiveLevel()
        places = AsynchronousLoopClosure(self._enqueue)
        self.loop_closure: LoopClosure = places if settings.loop_closure else NullLoopClosure()
        self._asynchronous_loop_closure = places
        job = MapperWorkerConfig(self._ring.memory, 0, maps_folder, settings, level)
        self._client = MapperClient(
            job, places.handle_message, self._force_keyframe, self._handle_worker_death
        )
        self._worker: WorkerThread[_QueueItem] = WorkerThread(
            "map", DropOldestQueue(2), self._write_to_ring, lambda: None
        )

    @property
    def warning(self) -> str:
        """What is wrong with it, in one clause."""
        return self._memory_fault or self._client.warning

    @property
    def state(self) -> MapState:
        """As `Mapper`."""
        return self._client.state

    @property
    def is_ready(self) -> bool:
        """Whether its process takes orders."""
        return self._client.is_ready

    def on_update(self, update: OdometryUpdate) -> None:
        """Pass a frame on (soon) if it is to be a keyframe or a place."""
        self._asynchronous_loop_closure.on_update(update)
        hop = self._constraints.update(update)
        if self._keyframe_selector.accepts(update) or hop is not None:
            self._enqueue(update, hop)

    def on_status(self, status: Status) -> None:
        """Nothing to remember."""

    def save(self, name: str) -> MapState:
        """As `Mapper`."""
        return self._client.save(name)

    def load(self, name: str) -> MapState:
        """As `Mapper`."""
        return self._client.load(name)

    def configure(self, settings: MapConfig) -> None:
        """As `Mapper`."""
        self._client.configure(settings)

    def close(self) -> None:
        """Forget everything; a map that is being made is given up."""
        if self._is_closed:
            return
        self._is_closed = True
        has_finished = self._worker.close(_CLOSE_TIMEOUT_S)
        self._client.close()
        if has_finished:
            self._ring.close()

    def _enqueue(
        self, update: OdometryUpdate, attachment: OdometryConstraint | RelocalizationQuery | None
    ) -> None:
        self._worker.put((update, attachment))

    def _write_to_ring(self, item: _QueueItem) -> None:
        """Body of the worker's thread. The map's world is `odom`, as the poses that go out."""
        update, more = item
        in_odom = replace(update, T_world_camera=update.T_odom_camera)
        try:
            write_frame(self._ring, in_odom, pack_depth, more)
            self._memory_fault = ""
        except OSError as error:
            self._memory_fault = f"map: no memory for a keyframe: {error.strerror}"

    def _force_keyframe(self) -> None:
        """The next good frame is a keyframe and a place, wherever it is."""
        self._keyframe_selector.reset()
        self._constraints.force_keyframe()

    def _handle_worker_death(self) -> int:
        """Keyframes and places are lost."""
        first = self._ring.record_count
        self._force_keyframe()
        self._asynchronous_loop_closure.reset()
        return first

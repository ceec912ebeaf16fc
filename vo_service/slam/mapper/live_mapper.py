"""Live mapper: an output that sends frames to the mapper process."""

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

# The process reads the ring several times a second: this is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_CLOSE_TIMEOUT_S = 1.0


# A frame for the process, and what is attached to it.
_QueueItem = tuple[OdometryUpdate, OdometryConstraint | RelocalizationQuery | None]


class LiveMapper:
    """Mapper whose frames go through shared memory to a process.

    The main loop only compares two poses; a thread copies the images of a frame.

    Args:
        settings: Config table `map`.
        maps_folder: Folder of the saved maps.

    Raises:
        OSError: The shared memory cannot be allocated.
    """

    def __init__(self, settings: MapConfig, maps_folder: Path) -> None:
        self._keyframe_selector = KeyframeSelector()
        self._constraints = (
            ConstraintAccumulator() if settings.loop_closure else NullConstraintAccumulator()
        )
        self._memory_fault = ""
        self._is_closed = False
        compile_kernels()
        self._ring = RecordRingWriter("map-keyframes", _RING_S, _RING_BYTES)
        level = logging.getLogger().getEffectiveLevel()
        loop_closure = AsynchronousLoopClosure(self._enqueue)
        self.loop_closure: LoopClosure = (
            loop_closure if settings.loop_closure else NullLoopClosure()
        )
        self._asynchronous_loop_closure = loop_closure
        worker_config = MapperWorkerConfig(self._ring.memory, 0, maps_folder, settings, level)
        self._client = MapperClient(
            worker_config,
            loop_closure.handle_message,
            self._force_keyframe,
            self._handle_worker_death,
        )
        self._worker: WorkerThread[_QueueItem] = WorkerThread(
            "map", DropOldestQueue(2), self._write_to_ring, lambda: None
        )

    @property
    def warning(self) -> str:
        """Current faults as one clause; "" for none."""
        return self._memory_fault or self._client.warning

    @property
    def state(self) -> MapState:
        """State of the map."""
        return self._client.state

    @property
    def is_ready(self) -> bool:
        """Whether its process is ready for requests."""
        return self._client.is_ready

    def on_update(self, update: OdometryUpdate) -> None:
        """Send the frame if it is selected as a keyframe of the mesh or of the map."""
        self._asynchronous_loop_closure.on_update(update)
        constraint = self._constraints.update(update)
        if self._keyframe_selector.accepts(update) or constraint is not None:
            self._enqueue(update, constraint)

    def on_status(self, status: Status) -> None:
        """Do nothing."""

    def save(self, name: str) -> MapState:
        """Start saving the map. Raises CommandError if that is not possible."""
        return self._client.save(name)

    def load(self, name: str) -> MapState:
        """Start loading a map. Raises CommandError if that is not possible."""
        return self._client.load(name)

    def configure(self, settings: MapConfig) -> None:
        """Apply settings to later keyframes and the next map."""
        self._client.configure(settings)

    def close(self) -> None:
        """End the process; a running save is cancelled."""
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
        """Write a frame to the ring, on the worker thread. The map's world frame is `odom`."""
        update, attachment = item
        in_odom = replace(update, T_world_camera=update.T_odom_camera)
        try:
            write_frame(self._ring, in_odom, pack_depth, attachment)
            self._memory_fault = ""
        except OSError as error:
            self._memory_fault = f"map: no memory for a keyframe: {error.strerror}"

    def _force_keyframe(self) -> None:
        """Make the next good frame a keyframe of the mesh and of the map."""
        self._keyframe_selector.reset()
        self._constraints.force_keyframe()

    def _handle_worker_death(self) -> int:
        """Reset after the loss of all keyframes; return the number of the next valid frame."""
        first_frame = self._ring.record_count
        self._force_keyframe()
        self._asynchronous_loop_closure.reset()
        return first_frame

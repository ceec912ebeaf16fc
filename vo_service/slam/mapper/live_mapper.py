"""The live mapper: an output that sends frames to the mapper process, and its loop closure."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core import UserFacingError
from drivers.core.files import state_folder
from drivers.core.flow_control import DropOldestQueue, WorkerThread
from drivers.core.process import RecordRingWriter
from vo_service.config_tables import MapConfig
from vo_service.frame_record import compile_kernels, pack_depth, write_frame
from vo_service.slam import (
    ConstraintAccumulator,
    KeyframeSelector,
    NullConstraintAccumulator,
    OdometryConstraint,
    RelocalizationResult,
)
from vo_service.slam.mapper import MapperClient, MapperWorkerConfig, RelocalizationQuery
from vo_service.types import MapSnapshot, OdometryUpdate
from vo_service.types.messages import MapState, Status
from vo_service.types.outputs import LoopClosure, Mapper, NullLoopClosure, NullMapper

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.slam.relocalization import AsynchronousLoopClosure

logger = logging.getLogger(__name__)

# The process reads the ring several times a second: this is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_CLOSE_TIMEOUT_S = 1.0


class NullAsynchronousLoopClosure(NullLoopClosure):
    """Null loop closure with the process: updates and messages are ignored."""

    def on_update(self, update: OdometryUpdate) -> None:
        """Ignore the update."""

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """Ignore the message."""

    def reset(self) -> None:
        """Do nothing: there is no map."""


# A frame for the process, and what is attached to it.
_QueueItem = tuple[OdometryUpdate, OdometryConstraint | RelocalizationQuery | None]


class LiveMapper:
    """A `Mapper` whose frames go through shared memory to a process.

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
        loop_closure = self._open_loop_closure(settings)
        self.loop_closure: LoopClosure = loop_closure
        self._asynchronous_loop_closure = loop_closure
        worker_config = MapperWorkerConfig(self._ring.memory, 0, maps_folder, settings)
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
        return self._memory_fault or self._client.warning

    @property
    def state(self) -> MapState:
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
        return self._client.save(name)

    def load(self, name: str) -> MapState:
        return self._client.load(name)

    def configure(self, settings: MapConfig) -> None:
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

    def _open_loop_closure(
        self, settings: MapConfig
    ) -> "AsynchronousLoopClosure | NullAsynchronousLoopClosure":
        if not settings.loop_closure:
            return NullAsynchronousLoopClosure()
        # Imported only if it is enabled.
        from vo_service.slam.relocalization import AsynchronousLoopClosure

        return AsynchronousLoopClosure(lambda update: self._enqueue(update, RelocalizationQuery()))

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


def open_mapper(settings: MapConfig) -> Mapper:
    """Open the mapper of the settings; a `NullMapper` if it fails."""
    try:
        return LiveMapper(settings, state_folder() / "maps")
    except UserFacingError as error:
        reason = f"map: disabled: {error}"
    except OSError as error:
        reason = f"map: disabled: no shared memory: {error.strerror}"
    logger.warning("%s", reason)
    return NullMapper(reason, reason)

"""The live mapper: an output that sends frames to the mapper process, and its loop closure."""

import logging
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core import UserFacingError
from drivers.core.files import state_folder
from drivers.core.flow_control import DropOldestQueue, WorkerThread
from drivers.core.geometry import inverse
from drivers.core.record_ring import RecordRingWriter
from vo_service.config_tables import MapConfig
from vo_service.frame_record import compile_kernels, pack_depth, write_frame
from vo_service.odometry.relocalization import RelocalizationResult, RelocalizingOdometry
from vo_service.slam import (
    ConstraintAccumulator,
    KeyframeSelector,
    NullConstraintAccumulator,
    OdometryConstraint,
)
from vo_service.slam.mapper import MapperClient, MapperWorkerConfig, RelocalizationQuery
from vo_service.types import NO_MAP, MapSnapshot, Odometry, OdometryUpdate
from vo_service.types.messages import MapState, Status
from vo_service.types.outputs import LoopClosure, Mapper, NullLoopClosure, NullMapper

logger = logging.getLogger(__name__)

# Largest number of results that are not polled.
_MAX_PENDING_RESULTS = 10
# The process reads the ring several times a second: this is far more than it needs.
_RING_S, _RING_BYTES = 60.0, 24_000_000
_CLOSE_TIMEOUT_S = 1.0


class AsynchronousLoopClosure:
    """Relocalizer of a `RelocalizingOdometry`, with the last snapshot of the map.

    `handle_message` and `reset` are called on another thread than the rest.

    Args:
        submit: Sends a frame to the process.
    """

    def __init__(self, submit: Callable[[OdometryUpdate, RelocalizationQuery], None]) -> None:
        self._submit = submit
        # From `odom` to the odometry's world frame, and its epoch.
        self._T_world_odom, self._epoch = np.eye(4), 0
        self._last_update: OdometryUpdate | None = None
        self._results: deque[RelocalizationResult] = deque(maxlen=_MAX_PENDING_RESULTS)
        self.snapshot: MapSnapshot = NO_MAP

    def wrap(self, odometry: Odometry) -> Odometry:
        """Wrap the odometry so that it relocalizes after a loss."""
        return RelocalizingOdometry(odometry, self)

    def on_update(self, update: OdometryUpdate) -> None:
        """Update the transform between the odometry's world frame and `odom`."""
        self._last_update = update
        if update.estimate.ok:
            self._T_world_odom = update.T_world_camera @ inverse(update.T_odom_camera)
            self._epoch = update.epoch

    @property
    def has_map(self) -> bool:
        """Whether the map has a keyframe."""
        return self.snapshot.keyframes > 0

    def query(self, frame: RgbdFrame) -> None:
        """Send the frame to the process as a query."""
        if self._last_update is not None:
            self._submit(
                replace(self._last_update, frame=frame, epoch=self._epoch), RelocalizationQuery()
            )

    def poll_results(self) -> Sequence[RelocalizationResult]:
        """Return the results since the last call."""
        results = []
        while self._results:
            results.append(self._results.popleft().transform_to(self._T_world_odom))
        return results

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """Handle a message of the process."""
        if isinstance(message, RelocalizationResult):
            self._results.append(message)
        else:
            self.snapshot = message

    def reset(self) -> None:
        """Drop the map after the process has lost it."""
        self.snapshot = NO_MAP


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
        loop_closure = AsynchronousLoopClosure(self._enqueue)
        self.loop_closure: LoopClosure = (
            loop_closure if settings.loop_closure else NullLoopClosure()
        )
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

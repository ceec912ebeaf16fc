"""The live mapper: an output that sends frames to the mapper process, and its loop closure.

Frames go through a ring of shared memory, requests and results through the client of the process.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.core import UserFacingError
from drivers.core.files import state_folder
from drivers.core.flow_control import DropOldestQueue, WorkerThread
from drivers.core.process.client import FaultReporter, WorkerClient
from drivers.core.process.record_ring import RecordRingWriter
from drivers.core.process.worker_spec import WorkerSpec
from vo_service.config_tables import MapConfig
from vo_service.frame_record import compile_kernels, pack_depth, write_frame
from vo_service.slam.keyframe_selection import (
    ConstraintAccumulator,
    KeyframeSelector,
    NullConstraintAccumulator,
    OdometryConstraint,
)
from vo_service.slam.mapper.map_store import MAP_SUFFIX, MESH_SUFFIX
from vo_service.slam.mapper.messages import (
    LoadMapRequest,
    LoadMapResult,
    MapperMessage,
    MapperStatus,
    MapperWorkerConfig,
    RelocalizationQuery,
    SaveMapRequest,
    SaveMapResult,
)
from vo_service.slam.relocalization import RelocalizationResult
from vo_service.types import MapSnapshot, OdometryUpdate
from vo_service.types.commands import NotPossibleError
from vo_service.types.messages import MapState, Status
from vo_service.types.outputs import LoopClosure, Mapper, NullLoopClosure, NullMapper

if TYPE_CHECKING:  # loaded only if it is enabled
    from vo_service.slam.relocalization import AsynchronousLoopClosure

logger = logging.getLogger(__name__)


NAME = "map"
WORKER_SPEC = WorkerSpec(
    "vo_service.mapper_process:run",
    NAME,
    start_timeout_s=300.0,  # it loads or compiles kernels, and a map
    exit_timeout_s=20.0,
    finishes_alone=True,
    nice=10,
    # The service can run without such a process, so it is killed first when memory runs out.
    oom_score_adj=800,
)


class MapperClient:
    """Client of the mapper process. It may be called from any thread and does not block.

    Args:
        config: Of the mapper process.
        on_map_message: Called with messages about the map.
        on_map_loaded: Called when a map has been loaded.
        on_worker_died: Called when the process died; returns the number of the next valid frame.
    """

    def __init__(
        self,
        config: MapperWorkerConfig,
        on_map_message: Callable[[MapSnapshot | RelocalizationResult], None],
        on_map_loaded: Callable[[], None],
        on_worker_died: Callable[[], int],
    ) -> None:
        self._on_map_message = on_map_message
        self._on_map_loaded, self._on_worker_died = on_map_loaded, on_worker_died
        self._lock = threading.Lock()
        self._map_names: frozenset[str] = frozenset()
        self._loadable_names: frozenset[str] = frozenset()
        self._save_faults, self._folder_faults, self._load_faults = (
            FaultReporter(NAME),
            FaultReporter(NAME),
            FaultReporter(NAME),
        )
        self._process_fault = ""
        self.state = MapState()
        self._config = config  # of the next process
        with self._lock:  # the callbacks wait until there is a supervisor
            self._supervisor = WorkerClient(
                WORKER_SPEC, lambda: self._config, self._handle_message, self._handle_worker_death
            )

    @property
    def is_ready(self) -> bool:
        """Whether the process is ready for requests."""
        return self._supervisor.is_ready

    @property
    def warning(self) -> str:
        """Current faults as one clause; "" for none."""
        if self._supervisor.is_unresponsive:
            return f"{NAME}: the mapper process does not respond; the disk may be blocked"
        faults = (
            self._process_fault,
            self._save_faults.text,
            self._folder_faults.text,
            self._load_faults.text,
        )
        fault = "; ".join(filter(None, faults))
        return f"{NAME}: {fault}" if fault else ""

    def save(self, name: str) -> MapState:
        """Start saving a map.

        Raises:
            CommandError: If that is not possible.
        """
        with self._lock:
            self._check_responsive()
            if self.state.saving:
                raise NotPossibleError(f"a map is already being saved: {self.state.saving}")
            if name in self._map_names:
                raise NotPossibleError(f"map {name!r} already exists; choose another name")
            if not self.state.mesh_keyframes:
                raise NotPossibleError("the map is empty: no frame has been tracked yet")
            self._save_faults.set("")
            file = self._config.maps_folder / f"{name}{MESH_SUFFIX}"
            self.state = replace(self.state, saving=str(file))
            self._supervisor.send(SaveMapRequest(name))
            return self.state

    def load(self, name: str) -> MapState:
        """Start loading a map.

        Raises:
            CommandError: If that is not possible.
        """
        with self._lock:
            self._check_responsive()
            if self.state.loading:
                raise NotPossibleError(f"a map is already being loaded: {self.state.loading}")
            if name not in self._loadable_names:
                available = ", ".join(sorted(self._loadable_names)) or "none"
                raise NotPossibleError(f"there is no map {name!r} to load; available: {available}")
            self._load_faults.set("")
            file = self._config.maps_folder / f"{name}{MAP_SUFFIX}"
            self.state = replace(self.state, loading=str(file))
            self._supervisor.send(LoadMapRequest(name))
            return self.state

    def configure(self, settings: MapConfig) -> None:
        """Apply settings to later keyframes and the next map."""
        self._config = replace(self._config, map_config=settings)
        self._supervisor.send(settings)

    def close(self) -> None:
        """End the process; a running save is cancelled."""
        self._supervisor.close()
        if self.state.saving:
            logger.warning("%s: the service stops; saving %s is cancelled", NAME, self.state.saving)

    def _handle_message(self, message: MapperMessage) -> None:
        match message:
            case MapperStatus(keyframes, map_names, loadable_names, fault):
                with self._lock:
                    self._map_names, self._loadable_names, self._process_fault = (
                        map_names,
                        loadable_names,
                        "",
                    )
                    self.state = replace(self.state, mesh_keyframes=keyframes)
                self._folder_faults.set(fault)
            case SaveMapResult():
                self._handle_save_result(message)
            case LoadMapResult():
                self._handle_load_result(message)
            case MapSnapshot() | RelocalizationResult():
                self._on_map_message(message)

    def _handle_save_result(self, result: SaveMapResult) -> None:
        file, fault = result.file, result.error
        if not fault:
            log_format = "%s: %s: %d triangles from %d keyframes"
            logger.info(log_format, NAME, file, result.triangle_count, result.keyframe_count)
        if result.is_truncated:
            fault = f"{file} is incomplete: increase map.mesh_memory_mb or map.voxel_m"
        self._save_faults.set(fault)
        with self._lock:
            saved = self.state.saved if result.error else str(file)
            map_names = self._map_names if result.error else self._map_names | {file.stem}
            self._map_names, self.state = map_names, replace(self.state, saving="", saved=saved)

    def _handle_load_result(self, result: LoadMapResult) -> None:
        if not result.error:
            logger.info("%s: %s: loaded %d keyframes", NAME, result.file, result.keyframe_count)
        self._load_faults.set(result.error)
        with self._lock:
            file = self.state.loaded if result.error else str(result.file)
            self.state = replace(self.state, loading="", loaded=file)
            if not result.error:  # a restarted process loads it as well
                settings = replace(self._config.map_config, load=result.file.stem)
                self._config = replace(self._config, map_config=settings)
        if not result.error:
            self._on_map_loaded()

    def _check_responsive(self) -> None:
        """Raise CommandError if requests would be lost. Called with the lock held."""
        if not self._supervisor.is_ready or self._supervisor.is_unresponsive:
            raise NotPossibleError("the mapper process does not respond; try again in a moment")

    def _handle_worker_death(self, reason: str) -> bool:
        with self._lock:
            saving = self.state.saving
            self.state = replace(self.state, mesh_keyframes=0, saving="", loading="", loaded="")
            self._process_fault = "the mapper process died and is restarted with an empty map"
            self._config = replace(self._config, first_frame=self._on_worker_died())
        logger.warning("%s: %s", NAME, self._process_fault)
        if saving:
            self._save_faults.set(f"saving {saving} was interrupted")
        return True


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

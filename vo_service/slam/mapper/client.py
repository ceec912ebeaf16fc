"""The mapper in the service: an output that sends frames and requests to the mapper process."""

import logging
from dataclasses import replace
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.folders import state_folder
from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.core.process.record_ring import RecordRingWriter
from drivers.core.process.worker_spec import WorkerSpec
from drivers.core.queues import DropOldestQueue
from vo_service.config_tables import MapConfig, ScanConfig
from vo_service.frame_packing import compile_kernels, write_frame
from vo_service.process_output import FaultReporter, ProcessOutput, warn_disabled
from vo_service.slam.keyframe_selection import (
    ConstraintAccumulator,
    KeyframeSelector,
    NullConstraintAccumulator,
    OdometryConstraint,
)
from vo_service.slam.mapper.map_store import MapStore
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
from vo_service.slam.relocalization import AsynchronousLoopClosure, RelocalizationResult
from vo_service.types.commands import NotPossibleError
from vo_service.types.map_snapshot import MapSnapshot
from vo_service.types.messages import MapState, Status
from vo_service.types.occupancy_grid import NO_GRID, OccupancyGrid
from vo_service.types.odometry_update import OdometryUpdate
from vo_service.types.outputs import Mapper, NullLoopClosure, NullMapper

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
# The process reads the ring several times a second, but it has a low priority. A moving camera has
# two keyframes a second, and of a Kinect 24 have a place.
_RING_S, _RING_BYTES = 60.0, 15_000_000

# A frame for the process, and what is attached to it.
_QueueItem = tuple[OdometryUpdate, OdometryConstraint | RelocalizationQuery | None]


class NullAsynchronousLoopClosure(NullLoopClosure):
    """Null loop closure with the process: updates and messages are ignored."""

    def on_update(self, update: OdometryUpdate) -> None:
        """Ignore the update."""

    def handle_message(self, message: RelocalizationResult | MapSnapshot) -> None:
        """Ignore the message."""

    def reset(self) -> None:
        """Do nothing: there is no map."""


class LiveMapper(ProcessOutput[_QueueItem, MapperWorkerConfig]):
    """A `Mapper` whose frames go through shared memory to a process.

    The main loop only compares two poses; a thread copies the images of a frame.

    Args:
        settings: Config table `map`.
        maps_folder: Folder of the saved maps.
        scan: Heights of the occupancy grid.
        T_base_camera: 4x4 pose of the optical camera in the base.

    Raises:
        OSError: The shared memory cannot be allocated.
    """

    def __init__(
        self,
        settings: MapConfig,
        maps_folder: Path,
        scan: ScanConfig = ScanConfig(),  # noqa: B008 (frozen)
        T_base_camera: Array = T_BODY_CAMERA,
    ) -> None:
        super().__init__(NAME)
        self.grid = NO_GRID
        self.state = MapState()
        self.loop_closure = (
            AsynchronousLoopClosure(self._send_query)
            if settings.loop_closure
            else NullAsynchronousLoopClosure()
        )
        self._store = MapStore(maps_folder)
        self._map_names = self._loadable_names = frozenset[str]()
        self._process_fault = ""
        self._save_faults, self._folder_faults, self._load_faults = (
            FaultReporter(NAME) for _ in range(3)
        )
        self._keyframe_selector = KeyframeSelector()
        self._constraints = (
            ConstraintAccumulator() if settings.loop_closure else NullConstraintAccumulator()
        )
        compile_kernels()
        self._ring = RecordRingWriter("map-keyframes", _RING_S, _RING_BYTES)
        config = MapperWorkerConfig(
            self._ring.memory, 0, maps_folder, settings, scan, T_base_camera
        )
        self._start(WORKER_SPEC, config, DropOldestQueue(2))

    def on_update(self, update: OdometryUpdate) -> None:
        """Send the frame if it is selected as a keyframe of the mesh or of the map."""
        self.loop_closure.on_update(update)
        constraint = self._constraints.update(update)
        if self._keyframe_selector.accepts(update) or constraint is not None:
            self._thread.put((update, constraint))

    def on_status(self, status: Status) -> None:
        """Do nothing."""

    def save(self, name: str) -> MapState:
        with self._requesting():
            if self.state.saving:
                raise NotPossibleError(f"a map is already being saved: {self.state.saving}")
            if name in self._map_names:
                raise NotPossibleError(f"map {name!r} already exists; choose another name")
            if not self.state.mesh_keyframes:
                raise NotPossibleError("the map is empty: no frame has been tracked yet")
            self._save_faults.set("")
            self.state = replace(self.state, saving=str(self._store.mesh_file(name)))
            self._client.send(SaveMapRequest(name))
            return self.state

    def load(self, name: str) -> MapState:
        with self._requesting():
            if self.state.loading:
                raise NotPossibleError(f"a map is already being loaded: {self.state.loading}")
            if name not in self._loadable_names:
                available = ", ".join(sorted(self._loadable_names)) or "none"
                raise NotPossibleError(f"there is no map {name!r} to load; available: {available}")
            self._load_faults.set("")
            self.state = replace(self.state, loading=str(self._store.map_file(name)))
            self._client.send(LoadMapRequest(name))
            return self.state

    def configure(self, settings: MapConfig) -> None:
        """Apply settings to later keyframes and the next map; the loaded map stays."""
        loaded = self._config.map_config.load
        self._config = replace(self._config, map_config=replace(settings, load=loaded))
        self._client.send(settings)

    @property
    def _fault(self) -> str:
        reported = self._save_faults.text, self._folder_faults.text, self._load_faults.text
        return "; ".join(filter(None, (self._process_fault, *reported)))

    def _send_query(self, update: OdometryUpdate) -> None:
        self._thread.put((update, RelocalizationQuery()))

    def _pass_on(self, item: _QueueItem) -> None:
        """Write a frame to the ring. The map's world frame is `odom`."""
        update, attachment = item
        in_odom = replace(update, T_world_camera=update.T_odom_camera)
        with self._writing_memory("a keyframe"):
            write_frame(self._ring, in_odom, attachment)

    def _handle_message(self, message: MapperMessage) -> None:
        match message:
            case MapperStatus():
                self._handle_status(message)
            case SaveMapResult():
                self._handle_save_result(message)
            case LoadMapResult():
                self._handle_load_result(message)
            case OccupancyGrid():
                self.grid = message
            case MapSnapshot() | RelocalizationResult():
                self.loop_closure.handle_message(message)

    def _handle_status(self, status: MapperStatus) -> None:
        self._folder_faults.set(status.error)
        with self._lock:
            self._process_fault = ""
            self._map_names, self._loadable_names = status.map_names, status.loadable_names
            self.state = replace(self.state, mesh_keyframes=status.keyframe_count)

    def _handle_save_result(self, result: SaveMapResult) -> None:
        file, fault = result.file, result.error
        if not fault:
            log_format = "%s: %s: %d triangles from %d keyframes"
            logger.info(log_format, NAME, file, result.triangle_count, result.keyframe_count)
        if result.is_truncated:
            fault = f"{file} is incomplete: increase map.mesh_memory_mb or map.voxel_m"
        self._save_faults.set(fault)
        with self._lock:
            if not result.error:
                self._map_names |= {file.stem}
                self.state = replace(self.state, saved=str(file))
            self.state = replace(self.state, saving="")

    def _handle_load_result(self, result: LoadMapResult) -> None:
        self._load_faults.set(result.error)
        with self._lock:
            if not result.error:  # a restarted process loads it as well
                logger.info("%s: %s: loaded %d keyframes", NAME, result.file, result.keyframe_count)
                if result.grid_fault:
                    log_format = "%s: %s: %s; the grid is empty until its places are seen again"
                    logger.warning(log_format, NAME, result.file, result.grid_fault)
                settings = replace(self._config.map_config, load=result.file.stem)
                self._config = replace(self._config, map_config=settings)
                self.state = replace(self.state, loaded=str(result.file), mesh_keyframes=0)
                self._force_keyframe()
            self.state = replace(self.state, loading="")

    def _handle_exit(self, reason: str) -> bool:
        """Report the loss of all keyframes; the next process starts with later frames."""
        with self._lock:
            loaded = self._config.map_config.load
            what = f"the map {loaded}" if loaded else "an empty map"
            self._process_fault = f"the mapper process died and is restarted with {what}"
            logger.warning("%s: %s", NAME, self._process_fault)
            if self.state.saving:
                self._save_faults.set(f"saving {self.state.saving} was interrupted")
            self.state = replace(self.state, mesh_keyframes=0, saving="", loading="", loaded="")
            self._config = replace(self._config, first_frame=self._ring.record_count)
        self.grid = NO_GRID
        self._force_keyframe()
        self.loop_closure.reset()
        return True

    def _force_keyframe(self) -> None:
        """Make the next good frame a keyframe of the mesh and of the map."""
        self._keyframe_selector.reset()
        self._constraints.force_keyframe()

    def _end(self, has_finished: bool, left_s: float) -> None:
        self._client.close()
        if self.state.saving:
            logger.warning("%s: the service stops; saving %s is cancelled", NAME, self.state.saving)
        if has_finished:
            self._ring.close()


def open_mapper(
    settings: MapConfig,
    scan: ScanConfig = ScanConfig(),  # noqa: B008 (frozen)
    T_base_camera: Array = T_BODY_CAMERA,
) -> Mapper:
    """Open the mapper of the settings; a `NullMapper` if it fails."""
    try:
        return LiveMapper(settings, state_folder() / "maps", scan, T_base_camera)
    except (UserFacingError, OSError) as error:
        reason = warn_disabled("map: disabled", "no shared memory", error)
        return NullMapper(reason, reason)

"""The mapper process: the messages between it and the service, and its client.

Frames go through the ring.
"""

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from re import fullmatch

from drivers.core.process import Heartbeat, RecordRingMemory, WorkerSpec
from drivers.core.process.supervisor import FaultReporter, WorkerSupervisor
from vo_service.config_tables import MapConfig
from vo_service.slam import RelocalizationResult
from vo_service.types import MapSnapshot
from vo_service.types.commands import NAME_PATTERN, CommandError, ErrorCode, NotPossibleError
from vo_service.types.messages import MapState

# Suffixes of a saved map's files: the mesh, and the keyframes with their pose graph.
MESH_SUFFIX = ".ply"
MAP_SUFFIX = ".keyframes"


@dataclass(frozen=True)
class MapperWorkerConfig:
    """Config of the mapper process.

    Attributes:
        frame_ring: Ring with the keyframes.
        first_frame: Number of the first valid frame.
        maps_folder: Folder of the saved maps.
        map_config: Config table `map`.
    """

    frame_ring: RecordRingMemory
    first_frame: int
    maps_folder: Path
    map_config: MapConfig

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that the process inherits."""
        return (self.frame_ring.fd,)


@dataclass(frozen=True)
class RelocalizationQuery:
    """Marks a frame in the ring as a request for its pose.

    A frame with an `OdometryConstraint` is a keyframe of the map; one with neither is only a mesh
    keyframe.
    """


@dataclass(frozen=True)
class SaveMapRequest:
    """To the mapper: save the map under this name, with its mesh."""

    name: str


@dataclass(frozen=True)
class LoadMapRequest:
    """To the mapper: drop the map, and load the map with this name."""

    name: str


@dataclass(frozen=True)
class MapperStatus(Heartbeat):
    """From the mapper: status, every second and after each keyframe.

    Attributes:
        keyframe_count: Number of mesh keyframes.
        map_names: Names of the saved maps.
        loadable_names: Names of the maps that can be loaded.
        error: Why the folder is not writable; "" if it is.
    """

    keyframe_count: int
    map_names: frozenset[str]
    loadable_names: frozenset[str]
    error: str = ""


@dataclass(frozen=True)
class SaveMapResult:
    """From the mapper: result of a `SaveMapRequest`.

    Attributes:
        file: Path of the mesh.
        keyframe_count: Number of fused keyframes.
        triangle_count: Number of triangles.
        is_truncated: Whether the memory was not enough for the whole mesh.
        error: "" for success.
    """

    file: Path
    keyframe_count: int = 0
    triangle_count: int = 0
    is_truncated: bool = False
    error: str = ""


@dataclass(frozen=True)
class LoadMapResult:
    """From the mapper: result of a `LoadMapRequest`; `error` is "" for success."""

    file: Path
    keyframe_count: int = 0
    error: str = ""


# A snapshot is sent when the map has changed, a relocalization result when a frame is recognized.
MapperMessage = MapperStatus | SaveMapResult | LoadMapResult | MapSnapshot | RelocalizationResult
SendMapperMessage = Callable[[MapperMessage], object]


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
            self._supervisor = WorkerSupervisor(
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
        _check_name(name)
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
        _check_name(name)
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


def _check_name(name: str) -> None:
    if not fullmatch(NAME_PATTERN, name):
        raise CommandError(
            ErrorCode.BAD_REQUEST,
            "a map name has up to 64 letters, digits, dots, dashes and underscores",
        )

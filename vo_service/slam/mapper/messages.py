"""The messages between the service and the mapper process."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from drivers.core.geometry import T_BODY_CAMERA, Array
from drivers.core.process.messages import Heartbeat
from drivers.core.process.record_ring import RecordRingMemory
from vo_service.config_tables import MapConfig, ScanConfig
from vo_service.slam.relocalization import RelocalizationResult
from vo_service.types.map_snapshot import MapSnapshot
from vo_service.types.occupancy_grid import OccupancyGrid


@dataclass(frozen=True)
class MapperWorkerConfig:
    """Config of the mapper process.

    Attributes:
        frame_ring: Ring with the keyframes.
        first_frame: Number of the first valid frame.
        maps_folder: Folder of the saved maps.
        map_config: Config table `map`.
        scan_config: Config table `scan`: the heights of the occupancy grid.
        T_base_camera: 4x4 pose of the optical camera in the base.
    """

    frame_ring: RecordRingMemory
    first_frame: int
    maps_folder: Path
    map_config: MapConfig
    scan_config: ScanConfig = ScanConfig()  # noqa: RUF009 (frozen)
    T_base_camera: Array = field(default_factory=lambda: T_BODY_CAMERA)

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
    """From the mapper: result of a `LoadMapRequest`.

    Attributes:
        file: Path of the map.
        keyframe_count: Number of its keyframes.
        error: "" for success.
        grid_fault: Why it has no cells of the occupancy grid; "" if it has.
    """

    file: Path
    keyframe_count: int = 0
    error: str = ""
    grid_fault: str = ""


# A snapshot and the grid are sent when they have changed, a relocalization result when a frame is
# recognized.
MapperMessage = (
    MapperStatus
    | SaveMapResult
    | LoadMapResult
    | MapSnapshot
    | RelocalizationResult
    | OccupancyGrid
)
SendMapperMessage = Callable[[MapperMessage], object]

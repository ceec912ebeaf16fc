"""The messages between the service and the viewer's process."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.bounded_trajectory import BoundedTrajectory
from drivers.core.geometry import Array
from drivers.core.process.messages import Heartbeat, WorkerFailed
from vo_service.outputs.rerun.sinks import Sink
from vo_service.types.estimate import OnlineTiming, TrackingDebug
from vo_service.types.odometry_update import TrackingState


@dataclass(frozen=True)
class RerunWorkerConfig:
    """Configuration of the viewer's process.

    Attributes:
        sink: Where the data goes.
        jpeg_quality: Quality of the color images, 0 to 100.
        recording_id: The same for all processes and files of a run, which Rerun shows as one.
    """

    sink: Sink
    jpeg_quality: int
    recording_id: str

    @property
    def fds(self) -> tuple[int, ...]:
        """No file descriptors."""
        return ()


@dataclass(frozen=True)
class TrackingStatus:
    """Tracking state, its reason and the epoch."""

    state: TrackingState
    reason: str
    epoch: int


@dataclass(frozen=True)
class FrameScalars:
    """Values sent for every frame. `counts`, `stage_ms` and `timing` are plotted by name."""

    seq: int
    stamp_s: float
    T_world_camera: Array
    counts: Mapping[str, int]
    stage_ms: Mapping[str, float]
    state: TrackingStatus
    timing: OnlineTiming | None


@dataclass(frozen=True)
class FrameImages:
    """Images sent for some frames, after their scalars."""

    frame: RgbdFrame
    evidence: TrackingDebug


@dataclass(frozen=True)
class TrajectoryPoint:
    """Next position of the trajectory in the world, meters."""

    position: Array
    epoch: int


@dataclass(frozen=True)
class GroundTruth:
    """(N, 3) positions of the ground truth, meters, aligned with the start of the estimate."""

    positions: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MapGraph:
    """The keyframe map, in the world.

    Attributes:
        positions: (N, 3) positions of the keyframes, meters; the newest is last.
        odometry_edges: (M, 2, 3) edges from odometry: the corrected trajectory.
        loop_edges: (L, 2, 3) edges from loop closures.
    """

    positions: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    odometry_edges: NDArray[np.float32] = field(
        default_factory=lambda: np.empty((0, 2, 3), np.float32)
    )
    loop_edges: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 2, 3), np.float32))


@dataclass(frozen=True)
class CorrectedPosition:
    """Corrected position of the camera, in the world, meters."""

    position: Array


@dataclass(frozen=True, eq=False)
class ScanPoints:
    """(N, 3) ends of the scan's ranges in the world, meters."""

    positions: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class GridCells:
    """Middles of the occupancy grid's cells in the world, meters.

    Attributes:
        occupied: (N, 3).
        free: (M, 3).
        size_m: Side of a cell.
    """

    occupied: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    free: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    size_m: float = 0.05


@dataclass(frozen=True)
class TextLog:
    """A line for the viewer's text log."""

    text: str


@dataclass(frozen=True)
class InitialState:
    """Everything drawn so far, sent first to each new process."""

    trajectory: BoundedTrajectory = field(default_factory=BoundedTrajectory)
    ground_truth: GroundTruth | None = None
    graph: MapGraph = field(default_factory=MapGraph)
    grid: GridCells = field(default_factory=GridCells)


RerunMessage = (
    InitialState
    | FrameScalars
    | FrameImages
    | TrajectoryPoint
    | GroundTruth
    | MapGraph
    | CorrectedPosition
    | ScanPoints
    | GridCells
    | TrackingStatus
    | TextLog
)


@dataclass(frozen=True)
class RerunHealth(Heartbeat):
    """Heartbeat of the viewer's process, several times a second from when the sink is open.

    Attributes:
        fault: The current fault, "" if there is none.
        data_loss: Why data was lost, "" if none was.
    """

    fault: str = ""
    data_loss: str = ""


RerunWorkerMessage = RerunHealth | WorkerFailed

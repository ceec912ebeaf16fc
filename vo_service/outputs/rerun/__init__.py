"""Images, poses and the map in Rerun, drawn by a separate process. Here: the messages to it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.geometry import Array
from drivers.core.process import Heartbeat, WorkerFailed
from vo_service.outputs.rerun.sinks import Sink
from vo_service.types import OnlineTiming, TrackingDebug, TrackingState

# A point closer than this to the last one is not visibly different.
MIN_POINT_DISTANCE_M = 0.005
# Above this, every second point is removed, so that days of driving fit.
MAX_POINTS = 4096


class BoundedTrajectory:
    """Polylines of positions, one per epoch."""

    def __init__(self, max_points: int = MAX_POINTS) -> None:
        self._max_points = max_points
        self._epoch: int | None = None
        self._lines: list[list[Array]] = []
        self._count = 0

    @property
    def lines(self) -> Sequence[Sequence[Array]]:
        """Positions in the world, meters."""
        return self._lines

    def add(self, position: Array, epoch: int) -> bool:
        """Add a position. Return False if it is too close to the last one."""
        if epoch != self._epoch:
            self._epoch = epoch
            self._lines.append([])
        line = self._lines[-1]
        if line and np.linalg.norm(position - line[-1]) < MIN_POINT_DISTANCE_M:
            return False
        line.append(position)
        self._count += 1
        if self._count > self._max_points:
            self._decimate()
        return True

    def _decimate(self) -> None:
        """Remove every second point, then the oldest lines if that is not enough."""
        self._lines = [_keep_every_second(line) for line in self._lines]
        self._count = sum(map(len, self._lines))
        while self._count > self._max_points:
            self._count -= len(self._lines.pop(0))


def _keep_every_second(line: list[Array]) -> list[Array]:
    """Keep the last point: the line continues from it."""
    return line[-1::-2][::-1]


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


RerunMessage = (
    InitialState
    | FrameScalars
    | FrameImages
    | TrajectoryPoint
    | GroundTruth
    | MapGraph
    | CorrectedPosition
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

"""What the service's process and the viewer's process say to each other."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from drivers.camera import RgbdFrame
from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array
from drivers.core.process.messages import LogMessage
from vo_service.outputs.rerun.bounded_trajectory import BoundedTrajectory
from vo_service.outputs.rerun.sinks import Sink
from vo_service.types import TrackingDebug, TrackingState


@dataclass(frozen=True)
class RerunWorkerConfig:
    """To the viewer's process, first and once.

    recording_id  the same for every process and file of a run: Rerun shows them as one recording
    log_level     of the service's log
    """

    sink: Sink
    jpeg_quality: int
    memory_mb: int
    recording_id: str
    log_level: int


@dataclass(frozen=True)
class TrackingStatus:
    """How far the pose can be trusted now."""

    state: TrackingState
    reason: str
    epoch: int


@dataclass(frozen=True)
class FrameScalars:
    """What goes out for every frame. `counts` and `stage_ms` are plotted by name."""

    seq: int
    stamp_s: float
    T_world_camera: Array
    counts: Mapping[str, int]
    stage_ms: Mapping[str, float]
    state: TrackingStatus


@dataclass(frozen=True)
class FrameImages:
    """What goes out for some frames, after their numbers."""

    frame: RgbdFrame
    evidence: TrackingDebug


@dataclass(frozen=True)
class TrajectoryPoint:
    """The trajectory goes on to this position in the world, metres."""

    position: Array
    epoch: int


@dataclass(frozen=True)
class GroundTruth:
    """(N, 3) positions of the true trajectory, moved to start where the estimate does."""

    positions: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MapGraph:
    """The map of places, in the world.

    positions  (N, 3) of the places, metres; the newest is the last
    motions    (M, 2, 3) from place to place as the odometry went: the corrected trajectory
    loops      (L, 2, 3) between two that were found to be one, or near each other
    """

    positions: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    odometry_edges: NDArray[np.float32] = field(
        default_factory=lambda: np.empty((0, 2, 3), np.float32)
    )
    loop_edges: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 2, 3), np.float32))


@dataclass(frozen=True)
class CorrectedPosition:
    """Where the camera is in the map, as a position in the world, metres."""

    position: Array


@dataclass(frozen=True)
class TextLog:
    """A line for the log beside the pictures."""

    text: str


@dataclass(frozen=True)
class InitialState:
    """Before all else: what is there already, as the process may not be the first."""

    trajectory: BoundedTrajectory = field(default_factory=BoundedTrajectory)
    ground_truth: GroundTruth | None = None
    graph: MapGraph = field(default_factory=MapGraph)


@dataclass(frozen=True)
class RerunShutdown:
    """Nothing follows: write out everything and end."""


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
    | RerunShutdown
)


@dataclass(frozen=True)
class RerunReady:
    """From the viewer's process: the place for the pictures is open."""


@dataclass(frozen=True)
class RerunWorkerFailed:
    """From the viewer's process, last: it cannot be, or not go on."""

    error: UserFacingError


@dataclass(frozen=True)
class RerunHealth:
    """From the viewer's process, several times a second: its sign of life.

    trouble     what is wrong now, "" while all is well
    incomplete  what could not be kept, "" if everything was
    """

    fault: str = ""
    data_loss: str = ""


RerunWorkerMessage = RerunReady | RerunWorkerFailed | RerunHealth | LogMessage

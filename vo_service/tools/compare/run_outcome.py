"""Result of one method on one recording."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Trajectory
from vo_service.types.failure_reasons import FailureReasons


class RunState(StrEnum):
    """State of a run, as text for people and scripts."""

    DONE = "done"
    CRASHED = "crashed"  # its process ended without a result
    ERROR = "error"  # a program error
    FAILED = "failed"  # a user-facing error
    TIMED_OUT = "timed out"
    NOT_RUN = "not run"  # the program was stopped earlier


# Columns of the results of frames.
FRAME_COLUMNS = np.dtype(
    [
        ("stamp_s", np.float64),  # as recorded
        ("has_pose", np.bool_),
        ("epoch", np.int64),  # number of discontinuities of the pose so far
        ("inliers", np.int64),
        ("cpu_ms", np.float64),  # processor time of the estimate, without reading and decoding
        ("wall_ms", np.float64),  # elapsed time of the same
        ("reason", np.object_),  # why there is no pose, or why the pose is degraded; else ""
    ]
)
# One row per frame, in order of time.
FrameLog = NDArray[np.void]


@dataclass(frozen=True)
class LoopClosureRun:
    """Result of loop closure in a run.

    Attributes:
        trajectory: Final optimized poses of the frames that are connected to a map keyframe.
        cpu_ms_per_frame: Mean processor time per frame, in addition to the method's.
    """

    trajectory: Trajectory
    map_keyframes: int
    loop_closures: int
    cpu_ms_per_frame: float


@dataclass(frozen=True)
class CompletedRun:
    """Result of a complete run.

    Attributes:
        frames: Result of each frame.
        trajectory: Poses in optical axes; the first camera is the world frame.
        skipped: Number of unreadable frames.
        stage_ms: Median processor time by stage, ms.
        memory_mb: Peak memory of the process, 10^6 bytes.
        loop_closure: None if loop closure was not enabled.
    """

    frames: FrameLog
    trajectory: Trajectory
    skipped: int = 0
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    memory_mb: float = 0.0
    loop_closure: LoopClosureRun | None = None

    @property
    def cpu_s(self) -> float:
        """Total processor time of all frames, s."""
        return float(self.frames["cpu_ms"].sum()) / 1e3

    @property
    def wall_s(self) -> float:
        """Total elapsed time of all frames, s."""
        return float(self.frames["wall_ms"].sum()) / 1e3

    @property
    def failed(self) -> int:
        """Number of frames without a pose."""
        return int(np.count_nonzero(~self.frames["has_pose"]))

    @property
    def no_motion_reason(self) -> str:
        """See `FailureReasons`."""
        reasons = FailureReasons()
        for has_pose, reason in self.frames[["has_pose", "reason"]].tolist():
            reasons.add(has_pose, reason)
        return reasons.no_motion_reason

    @property
    def new_epochs(self) -> int:
        """Number of discontinuities of the pose."""
        return int(self.frames["epoch"][-1]) if len(self.frames) else 0


EMPTY_RUN = CompletedRun(np.empty(0, FRAME_COLUMNS), Trajectory(np.empty(0), np.empty((0, 4, 4))))


@dataclass(frozen=True)
class RunOutcome:
    """Outcome of a run: a result or an error.

    Attributes:
        state: How the run ended.
        run: The result; empty unless the run is done.
        error: One line for people; "" if the run is done.
        details: Traceback of a program error.
    """

    state: RunState
    run: CompletedRun = EMPTY_RUN
    error: str = ""
    details: str = ""

    def __str__(self) -> str:
        """Return state and error, without repeating the state."""
        has_state = not self.error or self.error.startswith(self.state)
        return (self.error or self.state) if has_state else f"{self.state}: {self.error}"

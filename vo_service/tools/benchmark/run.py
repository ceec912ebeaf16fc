"""What one method did on one recording, and how it ended."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.trajectory import Trajectory


class RunState(StrEnum):
    """How a run ended; as a word for people and for scripts."""

    DONE = "done"
    CRASHED = "crashed"  # its process ended without an answer
    ERROR = "error"  # an error of the program
    FAILED = "failed"  # an error that says what to do
    TIMED_OUT = "timed out"
    NOT_RUN = "not run"  # the program was stopped before


@dataclass(frozen=True)
class FrameLog:
    """What became of each of F frames, in order of time.

    stamps_s         (F,) as recorded
    is_good          (F,) has a pose of its own
    epochs           (F,) counts how often the pose was not continuous with the one before
    inliers          (F,)
    cpu_ms, wall_ms  (F,) of the estimate alone: reading and decoding are not in them
    reasons          (F,) why there is no pose, "" where there is one
    """

    stamps_s: Array
    has_pose: NDArray[np.bool_]
    epochs: NDArray[np.int64]
    inliers: NDArray[np.int64]
    cpu_ms: Array
    wall_ms: Array
    reasons: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.stamps_s)

    @classmethod
    def from_rows(cls, rows: list[tuple[float, bool, int, int, float, float, str]]) -> "FrameLog":
        """From one row a frame: the fields in their order."""
        columns = list(zip(*rows, strict=True)) if rows else [()] * 7
        return cls(
            np.array(columns[0], np.float64),
            np.array(columns[1], np.bool_),
            np.array(columns[2], np.int64),
            np.array(columns[3], np.int64),
            np.array(columns[4], np.float64),
            np.array(columns[5], np.float64),
            tuple(str(reason) for reason in columns[6]),
        )


@dataclass(frozen=True)
class LoopClosureRun:
    """What known places made of a run.

    trajectory     corrected by what was known in the end, of the frames that lie by a place
    places, loops  how many there are in the end
    cpu_ms         mean processor time of a frame, beside that of the method
    """

    trajectory: Trajectory
    map_keyframes: int
    loop_closures: int
    cpu_ms_per_frame: float


@dataclass(frozen=True)
class CompletedRun:
    """A run to its end.

    frames      what became of each frame
    trajectory  the poses of the good ones, optical axes, the first camera as world
    skipped     frames that could not be read
    stage_ms    median CPU milliseconds by stage
    memory_mb   the most memory that its process took
    with_loops  None where they were not asked for
    """

    frames: FrameLog
    trajectory: Trajectory
    skipped: int = 0
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    memory_mb: float = 0.0
    loop_closure: LoopClosureRun | None = None

    @property
    def cpu_s(self) -> float:
        """Processor time of all frames together."""
        return float(self.frames.cpu_ms.sum()) / 1e3

    @property
    def wall_s(self) -> float:
        """Time that passed during it."""
        return float(self.frames.wall_ms.sum()) / 1e3

    @property
    def cpu_ms_per_frame(self) -> float:
        """Median; 0 of no frames."""
        return float(np.median(self.frames.cpu_ms)) if len(self.frames) else 0.0

    @property
    def failed(self) -> int:
        """Frames without a pose."""
        return int(np.count_nonzero(~self.frames.has_pose))

    @property
    def new_epochs(self) -> int:
        """How often the pose was not continuous with the one before."""
        return int(self.frames.epochs[-1]) if len(self.frames) else 0


EMPTY_RUN = CompletedRun(FrameLog.from_rows([]), Trajectory(np.empty(0), np.empty((0, 4, 4))))


@dataclass(frozen=True)
class RunOutcome:
    """How a run ended: with a result, or with the trouble that there was.

    trouble  one line for people, "" when done
    details  the program's own account of an error: its traceback
    """

    state: RunState
    run: CompletedRun = EMPTY_RUN
    error: str = ""
    details: str = ""

    def __str__(self) -> str:
        """The state and the trouble, which may say the state already."""
        has_state = not self.error or self.error.startswith(self.state)
        return (self.error or self.state) if has_state else f"{self.state}: {self.error}"

"""How a method is made in the process that runs it."""

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import Protocol

from drivers.trajectory import Trajectory
from vo_service.odometry.stopwatch import StageTimer
from vo_service.types import Odometry


class SfmScale(StrEnum):
    """Where a method without a scale of its own gets its first metre from."""

    FIRST_DEPTH = "first-depth"
    GROUND_TRUTH = "ground-truth"


class MethodFactory(Protocol):
    """Makes an odometry. Goes to another process, so it can be pickled."""

    @property
    def settings(self) -> Mapping[str, object]:
        """All that changes the result, for JSON."""
        ...

    @property
    def uses_truth(self) -> bool:
        """Whether the ground truth changes the result."""
        ...

    def prepare(self, on_progress: Callable[[str], None]) -> None:
        """Compile what is to be compiled, and tell what is being done."""
        ...

    def make(self, stopwatch: StageTimer, truth: Trajectory | None) -> Odometry:
        """The odometry."""
        ...

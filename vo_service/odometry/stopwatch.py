"""Where the time goes, stage by stage. The odometry names its stages; the caller brings a clock."""

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class StageTimer(Protocol):
    """Measures the stages of one frame: ``with stopwatch.stage("surf"): ...``."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        ...


class NullStageTimer:
    """Measures nothing: the odometry alone has no clock."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Do nothing."""
        return nullcontext()

"""Where the time goes, stage by stage. The odometry names its stages; the caller brings a clock."""

import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
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


class CpuStageTimer:
    """Adds up the processor time of this thread by stage, for one frame at a time."""

    def __init__(self) -> None:
        self._stages_ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one named stage."""
        begin_s = time.thread_time()
        try:
            yield
        finally:
            spent_ms = (time.thread_time() - begin_s) * 1e3
            self._stages_ms[name] = self._stages_ms.get(name, 0.0) + spent_ms

    def take_stage_ms(self) -> Mapping[str, float]:
        """Milliseconds by stage since the last call."""
        stages_ms, self._stages_ms = self._stages_ms, {}
        return stages_ms

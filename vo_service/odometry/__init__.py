"""Odometry methods. They are pure: frames in, estimates out; no files, no threads.

A method names its stages; the caller provides the timer.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol


class StageTimer(Protocol):
    """Timer of the stages of one frame: ``with timer.stage("surf"): ...``."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        ...


class NullStageTimer:
    """Timer that measures nothing."""

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Do nothing."""
        return nullcontext()


class CpuStageTimer:
    """Timer that sums this thread's processor time by stage."""

    def __init__(self) -> None:
        self._stages_ms: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one named stage."""
        start_s = time.thread_time()
        try:
            yield
        finally:
            elapsed_ms = (time.thread_time() - start_s) * 1e3
            self._stages_ms[name] = self._stages_ms.get(name, 0.0) + elapsed_ms

    def take_stage_ms(self) -> Mapping[str, float]:
        """Return and reset the milliseconds by stage."""
        stages_ms, self._stages_ms = self._stages_ms, {}
        return stages_ms

"""Odometry methods. They are pure: frames in, estimates out; no files, no threads.

A method names its stages; the caller provides the timer.
"""

import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, nullcontext
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


class _TimedStage:
    """One stage; a generator would cost more than some stages do."""

    def __init__(self, stages_ms: dict[str, float], name: str) -> None:
        self._stages_ms, self._name = stages_ms, name

    def __enter__(self) -> None:
        self._begin_s = time.thread_time()

    def __exit__(self, *_: object) -> None:
        elapsed_ms = (time.thread_time() - self._begin_s) * 1e3
        self._stages_ms[self._name] = self._stages_ms.get(self._name, 0.0) + elapsed_ms


class CpuStageTimer:
    """Timer that sums this thread's processor time by stage."""

    def __init__(self) -> None:
        self._stages_ms: dict[str, float] = {}

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Time one named stage."""
        return _TimedStage(self._stages_ms, name)

    def take_stage_ms(self) -> Mapping[str, float]:
        """Return and reset the milliseconds by stage."""
        stages_ms, self._stages_ms = self._stages_ms, {}
        return stages_ms

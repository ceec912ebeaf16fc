"""Timers of a method's stages. A method names its stages; the caller provides the timer."""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager


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


# Milliseconds of processor time by stage, as the mean over all frames, for methods with a budget.
# That of `direct` is with a rolling shutter; its sum is a quarter of one processor at 30 Hz.
# Without a rolling shutter, half of `align` is enough.
STAGE_BUDGETS_MS: Mapping[str, Mapping[str, float]] = {
    "direct": {
        "images": 0.5,
        "align": 3.7,
        "recovery": 1.0,
        "covariance": 1.0,
        "refine": 0.5,
        "keyframe": 0.8,
        "calibration": 0.7,
    }
}


class StageReporter:
    """Stage timer that only reports each stage's name."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self._report = report

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Report the stage's name."""
        self._report(name)
        yield

"""The stopwatch that the service gives to the odometry: processor time of each stage."""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager


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

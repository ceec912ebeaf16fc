"""Recorder of each frame's result during a run."""

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from statistics import median

import numpy as np

from drivers.camera import RgbdFrame
from drivers.core.errors import UserFacingError
from drivers.core.trajectory import Trajectory
from vo_service.tools.benchmark.run import CompletedRun, FrameLog, LoopClosureRun
from vo_service.types import Estimate


class RunRecorder:
    """Recorder with one row per frame."""

    def __init__(self) -> None:
        self._rows: list[tuple[float, bool, int, int, float, float, str]] = []
        self._stamps_s: list[float] = []
        self._poses: list[np.ndarray] = []
        self._epoch = 0
        self._stages_ms: defaultdict[str, list[float]] = defaultdict(list)

    def __len__(self) -> int:
        return len(self._rows)

    def add_frame(self, frame: RgbdFrame, estimate: Estimate, cpu_s: float, wall_s: float) -> None:
        """Add the result of a frame and its processor and elapsed time, s."""
        self._epoch += estimate.is_reset
        times_ms = 1e3 * cpu_s, 1e3 * wall_s
        state = frame.stamp_s, estimate.ok, self._epoch, estimate.inliers
        self._rows.append((*state, *times_ms, estimate.reason))
        if estimate.ok:
            self._stamps_s.append(frame.stamp_s)
            self._poses.append(estimate.T_world_camera)

    def add_stages(self, stages_ms: Mapping[str, float]) -> None:
        """Add the times of one frame by stage, ms."""
        for stage, time_ms in stages_ms.items():
            self._stages_ms[stage].append(time_ms)

    def finish(self, skipped: int, loop_closure: LoopClosureRun | None = None) -> CompletedRun:
        """Return the complete run.

        Raises:
            UserFacingError: If a pose is not finite.
        """
        poses = np.array(self._poses, np.float64).reshape(-1, 4, 4)
        if not np.isfinite(poses).all():
            raise UserFacingError("a pose is not finite; this is an error of the method, report it")
        return CompletedRun(
            frames=FrameLog.from_rows(self._rows),
            trajectory=Trajectory(np.array(self._stamps_s), poses),
            skipped=skipped,
            stage_ms={stage: median(times_ms) for stage, times_ms in self._stages_ms.items()},
            memory_mb=peak_memory_mb(),
            loop_closure=loop_closure,
        )


def peak_memory_mb() -> float:
    """Return the peak memory of this process, 10^6 bytes.

    The peak of `getrusage` would include the parent process before the fork.
    """
    lines = Path("/proc/self/status").read_text().splitlines()
    peak = next(line for line in lines if line.startswith("VmHWM:"))
    return int(peak.split()[1]) * 1024 / 1e6

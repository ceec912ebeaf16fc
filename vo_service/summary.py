"""The figures at the end of a run: for scripts as JSON, for people as a table."""

import logging
from dataclasses import dataclass
from typing import Any, Self

from drivers.camera import CameraCounters
from drivers.errors import InputError
from drivers.geometry import Array
from drivers.trajectory import StampedPoses
from vo_service.evaluation import Evaluation, evaluate
from vo_service.evaluation.report import aligned
from vo_service.statistics import Statistics

logger = logging.getLogger(__name__)

# Keys that are there, and null, where there is no ground truth to evaluate with.
EVALUATED = tuple(Evaluation.__dataclass_fields__)


@dataclass(frozen=True)
class Summary:
    """What a run did, and how good its trajectory is where the truth is known."""

    statistics: Statistics
    counters: CameraCounters
    evaluation: Evaluation | None

    @classmethod
    def of(
        cls,
        statistics: Statistics,
        counters: CameraCounters,
        trajectory: StampedPoses,
        truth: StampedPoses | None,
        frames_s: Array,
    ) -> Self:
        """Evaluate the trajectory, if there is a truth and enough of both; frames_s as there."""
        evaluation = None
        if truth is not None and len(trajectory):
            try:
                evaluation = evaluate(trajectory, truth, frames_s)
            except InputError as error:
                logger.warning("no evaluation: %s", error)
        return cls(statistics, counters, evaluation)

    def as_json(self) -> dict[str, Any]:
        """One flat object; null for what could not be computed."""
        statistics, counters = self.statistics, self.counters
        rolling = statistics.rolling()
        evaluated = self.evaluation.as_json() if self.evaluation else dict.fromkeys(EVALUATED)
        return {
            "frames": statistics.frames,
            "failed": statistics.failed,
            "skipped": counters.skipped + statistics.stale,
            "dropped": counters.dropped,
            "fps": round(statistics.mean_fps, 3),
            "latency_p50_ms": round(rolling.latency_p50_ms, 3),
            "latency_p99_ms": round(rolling.latency_p99_ms, 3),
            "cpu_ms_per_frame": round(statistics.cpu_ms_per_frame, 3),
            "stage_ms": {name: round(spent, 3) for name, spent in statistics.stage_ms.items()},
            **evaluated,
        }

    def as_table(self) -> str:
        """Aligned text for a terminal."""
        statistics, counters = self.statistics, self.counters
        rolling = statistics.rolling()
        stages = ", ".join(f"{name} {spent:.2f}" for name, spent in statistics.stage_ms.items())
        rows = [
            ("frames", f"{statistics.frames:6d}"),
            ("failed", f"{statistics.failed:6d}"),
            ("skipped", f"{counters.skipped + statistics.stale:6d}"),
            ("dropped", f"{counters.dropped:6d}"),
            ("rate", f"{statistics.mean_fps:6.1f} frames/s"),
            (
                "latency",
                f"{rolling.latency_p50_ms:6.1f} ms median, {rolling.latency_p99_ms:.1f} ms p99",
            ),
            ("CPU a frame", f"{statistics.cpu_ms_per_frame:6.1f} ms ({stages})"),
        ]
        return aligned(rows + (self.evaluation.rows() if self.evaluation else []))

"""Metrics of the bench: the columns of its tables."""

from collections.abc import Callable, Mapping

import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.benchmark.evaluate_run import RunEvaluation
from vo_service.tools.benchmark.report.table import (
    MetricColumn,
    from_evaluation,
    from_loop_closure,
    from_optimized_evaluation,
    from_run,
)
from vo_service.tools.benchmark.run import FrameLog

STATISTICS: Mapping[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "median": lambda values: float(np.median(values)),
    "p95": lambda values: float(np.percentile(values, 95)),
    "p99": lambda values: float(np.percentile(values, 99)),
}


def _time_metrics(
    key: str, heading: str, times_of: Callable[[FrameLog], Array]
) -> tuple[MetricColumn, ...]:
    """Return columns with statistics of the times per frame; the first heading names the time."""

    def metric(name: str, statistic: Callable[[Array], float]) -> MetricColumn:
        def value(evaluation: RunEvaluation) -> float | None:
            times_ms = times_of(evaluation.outcome.run.frames)
            return statistic(times_ms) if len(times_ms) else None

        return MetricColumn(
            f"{key}_{name}", f"{heading} {name}" if name == "mean" else name, value, 1
        )

    return tuple(metric(name, statistic) for name, statistic in STATISTICS.items())


ERROR_METRICS = (
    MetricColumn("ate_rmse_m", "ATE mm", from_evaluation("ate_rmse_m"), 2, 1e3),
    MetricColumn(
        "mean_global_error_m", "global mm", from_evaluation("mean_global_error_m"), 2, 1e3
    ),
    MetricColumn("rpe_frame_m", "RPE mm", from_evaluation("rpe_frame_m"), 2, 1e3),
    MetricColumn("rpe_frame_deg", "RPE °", from_evaluation("rpe_frame_deg"), 3),
    MetricColumn("rpe_1s_m", "RPE 1 s mm", from_evaluation("rpe_1s_m"), 2, 1e3),
    MetricColumn("rpe_1s_deg", "RPE 1 s °", from_evaluation("rpe_1s_deg"), 3),
)
ROBUSTNESS_METRICS = (
    MetricColumn("coverage", "coverage %", lambda evaluation: evaluation.coverage, 1, 100.0),
    MetricColumn("failed", "lost", from_run(lambda run: run.failed), 0),
    MetricColumn("new_epochs", "epochs", from_run(lambda run: run.new_epochs), 0),
    MetricColumn("gross_errors", "gross", lambda evaluation: evaluation.gross_errors, 0),
    MetricColumn("steps", "of", lambda evaluation: evaluation.steps, 0),
)
CPU_METRICS = _time_metrics("cpu_ms", "CPU ms", lambda frames: frames.cpu_ms)
WALL_METRICS = _time_metrics("wall_ms", "wall ms", lambda frames: frames.wall_ms)
MEMORY_METRIC = MetricColumn("memory_mb", "memory MB", from_run(lambda run: run.memory_mb), 0)
# Additional columns with loop closure.
LOOP_CLOSURE_METRICS = (
    MetricColumn(
        "optimized_ate_rmse_m", "optimized ATE mm",
        from_optimized_evaluation("ate_rmse_m"), 2, 1e3,
    ),
    MetricColumn(
        "optimized_mean_global_error_m", "optimized global mm",
        from_optimized_evaluation("mean_global_error_m"), 2, 1e3,
    ),
    MetricColumn("map_keyframes", "keyframes", from_loop_closure(lambda run: run.map_keyframes), 0),
    MetricColumn("loop_closures", "loops", from_loop_closure(lambda run: run.loop_closures), 0),
)  # fmt: skip
LOOP_CLOSURE_CPU_METRIC = MetricColumn(
    "loop_closure_ms_per_frame", "loops ms", from_loop_closure(lambda run: run.cpu_ms_per_frame), 2
)

ALL_METRICS = (*ERROR_METRICS, *ROBUSTNESS_METRICS, *CPU_METRICS, *WALL_METRICS, MEMORY_METRIC)
# Metrics whose ratio to the baseline method is meaningful.
RATIO_METRICS = (*ERROR_METRICS, *CPU_METRICS, *WALL_METRICS, MEMORY_METRIC)


def ratio(
    metric: MetricColumn, evaluation: RunEvaluation, reference: RunEvaluation
) -> float | None:
    """Return the ratio of a metric to that of the baseline method, or None if not known."""
    value, reference_value = metric.value(evaluation), metric.value(reference)
    return value / reference_value if value is not None and reference_value else None


def metric_values(evaluation: RunEvaluation) -> dict[str, float | None]:
    """Return every metric by its key."""
    return {metric.key: metric.value(evaluation) for metric in ALL_METRICS}


def metric_ratios(evaluation: RunEvaluation, reference: RunEvaluation) -> dict[str, float | None]:
    """Return every ratio by its metric's key."""
    return {metric.key: ratio(metric, evaluation, reference) for metric in RATIO_METRICS}

"""Metrics of a run: one set with names for files and headings for tables."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from vo_service.tools.compare.results import RunEvaluation, SequenceResults

MetricFunction = Callable[[RunEvaluation], float | None]


@dataclass(frozen=True)
class Metric:
    """Metric of a run.

    Attributes:
        key: Name for scripts.
        heading: Heading for people.
        value: Function that returns the metric of a run; None if not known.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed value.
    """

    key: str
    heading: str
    value: MetricFunction
    digits: int = 0
    display_factor: float = 1.0

    def ratio(self, evaluation: RunEvaluation, reference: RunEvaluation | None) -> float | None:
        """Return the ratio to the value of the baseline method's run, or None if not known."""
        value = self.value(evaluation)
        reference_value = None if reference is None else self.value(reference)
        return value / reference_value if value is not None and reference_value else None


def _at(path: str) -> MetricFunction:
    """Return a function for an attribute of a complete run; None if a part of its path is None."""

    def value(evaluation: RunEvaluation) -> float | None:
        found: Any = evaluation if evaluation.is_done else None
        for name in path.split("."):
            found = None if found is None else getattr(found, name)
        number: float | None = found
        return number

    return value


STATISTICS: Mapping[str, Callable[[Any], Any]] = {
    "mean": np.mean,
    "median": np.median,
    "p95": partial(np.percentile, q=95),
    "p99": partial(np.percentile, q=99),
}


def _times(key: str, heading: str) -> Iterator[Metric]:
    """Yield the statistics of a time per frame; only the first heading names the time."""
    for name, statistic in STATISTICS.items():
        first = f"{heading} " if name == "mean" else ""
        yield Metric(f"{key}_{name}", f"{first}{name}", _statistic_of(key, statistic), 1)


def _statistic_of(key: str, statistic: Callable[[Any], Any]) -> MetricFunction:
    def value(evaluation: RunEvaluation) -> float | None:
        times_ms = evaluation.outcome.run.frames[key]
        return float(statistic(times_ms)) if len(times_ms) else None

    return value


GLOBAL_ERROR = Metric(
    "mean_global_error_m", "global mm", _at("evaluation.mean_global_error_m"), 2, 1e3
)
ERRORS = (
    Metric("ate_rmse_m", "ATE mm", _at("evaluation.ate_rmse_m"), 2, 1e3),
    GLOBAL_ERROR,
    Metric("rpe_frame_m", "RPE mm", _at("evaluation.rpe_frame_m"), 2, 1e3),
    Metric("rpe_frame_deg", "RPE °", _at("evaluation.rpe_frame_deg"), 3),
    Metric("rpe_1s_m", "RPE 1 s mm", _at("evaluation.rpe_1s_m"), 2, 1e3),
    Metric("rpe_1s_deg", "RPE 1 s °", _at("evaluation.rpe_1s_deg"), 3),
)
COVERAGE = Metric("coverage", "coverage %", _at("coverage"), 1, 100.0)
ROBUSTNESS = (
    COVERAGE,
    Metric("failed", "lost", _at("outcome.run.failed")),
    Metric("new_epochs", "epochs", _at("outcome.run.new_epochs")),
    Metric("gross_errors", "gross", _at("gross_errors")),
    Metric("steps", "of", _at("steps")),
)
COST = (
    *_times("cpu_ms", "CPU ms"),
    *_times("wall_ms", "wall ms"),
    Metric("memory_mb", "memory MB", _at("outcome.run.memory_mb")),
)
TOTAL_TIMES = (
    Metric("cpu_s", "CPU s", _at("outcome.run.cpu_s"), 2),
    Metric("wall_s", "wall s", _at("outcome.run.wall_s"), 2),
)
# Additional columns with loop closure.
_OPTIMIZED, _LOOP_CLOSURE = "optimized_evaluation", "outcome.run.loop_closure"
LOOP_CLOSURE = (
    Metric("optimized_ate_rmse_m", "optimized ATE mm", _at(f"{_OPTIMIZED}.ate_rmse_m"), 2, 1e3),
    Metric(
        "optimized_mean_global_error_m",
        "optimized global mm",
        _at(f"{_OPTIMIZED}.mean_global_error_m"),
        2,
        1e3,
    ),
    Metric("map_keyframes", "keyframes", _at(f"{_LOOP_CLOSURE}.map_keyframes")),
    Metric("loop_closures", "loops", _at(f"{_LOOP_CLOSURE}.loop_closures")),
)
LOOP_CLOSURE_COST = Metric(
    "loop_closure_ms_per_frame", "loops ms", _at(f"{_LOOP_CLOSURE}.cpu_ms_per_frame"), 2
)
METRICS = (*ERRORS, *ROBUSTNESS, *COST, *TOTAL_TIMES)
# Metrics whose ratio to the baseline method is meaningful.
RATIO_METRICS = (*ERRORS, *COST)


def all_metrics(has_loop_closure: bool) -> tuple[Metric, ...]:
    """Return every metric of a run."""
    return (*METRICS, *LOOP_CLOSURE, LOOP_CLOSURE_COST) if has_loop_closure else METRICS


def metrics_as_json(result: SequenceResults, method: str) -> dict[str, object]:
    """Return every metric by its key, and under `ratios` those relative to the baseline method."""
    evaluation, reference = result.evaluations[method], result.reference
    ratios = () if reference is None else RATIO_METRICS
    return {
        **{metric.key: metric.value(evaluation) for metric in all_metrics(result.has_loop_closure)},
        "ratios": {metric.key: metric.ratio(evaluation, reference) for metric in ratios},
    }

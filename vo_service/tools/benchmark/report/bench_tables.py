"""Tables of the bench, two for people and one for scripts, and their columns."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from drivers.core.geometry import Array
from vo_service.tools.benchmark.report.table import (
    MetricColumn,
    Table,
    TableCell,
    from_evaluation,
    from_loop_closure,
    from_optimized_evaluation,
    from_run,
    number_cell,
    text_cell,
)
from vo_service.tools.benchmark.results import RunEvaluation, SequenceResults
from vo_service.tools.benchmark.run import FrameLog

STATISTICS: Mapping[str, Callable[[Array], float]] = {
    "mean": lambda values: float(np.mean(values)),
    "median": lambda values: float(np.median(values)),
    "p95": lambda values: float(np.percentile(values, 95)),
    "p99": lambda values: float(np.percentile(values, 99)),
}
# These columns show a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


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
    """Return the ratio of a metric to that of the baseline method, or None if not known.

    Args:
        metric: The metric.
        evaluation: The run.
        reference: The run of the baseline method.
    """
    value, reference_value = metric.value(evaluation), metric.value(reference)
    return value / reference_value if value is not None and reference_value else None


def metric_values(evaluation: RunEvaluation) -> dict[str, float | None]:
    """Return every metric by its key."""
    return {metric.key: metric.value(evaluation) for metric in ALL_METRICS}


def metric_ratios(evaluation: RunEvaluation, reference: RunEvaluation) -> dict[str, float | None]:
    """Return every ratio by its metric's key."""
    return {metric.key: ratio(metric, evaluation, reference) for metric in RATIO_METRICS}


@dataclass(frozen=True)
class RelativeResults:
    """Results of one recording at one frame step, relative to a baseline method."""

    results: SequenceResults
    reference_method: str

    @property
    def reference_evaluation(self) -> RunEvaluation:
        """Evaluation of the baseline method."""
        return self.results.evaluations[self.reference_method]

    @property
    def title(self) -> str:
        """Recording and selected frames, as a heading."""
        recording = self.results.recording
        step = recording.frame_selection.step
        frames = f"{len(recording.frame_stamps_s)} frames in {recording.duration_s:.1f} s"
        used = "every frame" if step == 1 else f"1 frame in {step}"
        truth = (
            "" if recording.truth is not None else ", no groundtruth.txt, so errors are not known"
        )
        return f"{recording.folder.resolve().name}, {used}: {frames}{truth}"

    def error_table(self) -> Table:
        """Return the table of errors and lost frames."""
        title = f"{self.title}; in () relative to {self.reference_method}"
        loop_closure_metrics = LOOP_CLOSURE_METRICS if self.results.has_loop_closure else ()
        return self._table(title, (*ERROR_METRICS, *ROBUSTNESS_METRICS, *loop_closure_metrics))

    def cost_table(self) -> Table:
        """Return the table of times per frame and memory."""
        loop_closure_metrics = (LOOP_CLOSURE_CPU_METRIC,) if self.results.has_loop_closure else ()
        return self._table("", (*CPU_METRICS, *WALL_METRICS, MEMORY_METRIC, *loop_closure_metrics))

    def _table(self, title: str, metrics: Sequence[MetricColumn]) -> Table:
        rows = [
            [
                _name_cell(method, evaluation),
                *(self._cell(metric, evaluation) for metric in metrics),
            ]
            for method, evaluation in self.results.evaluations.items()
        ]
        keys = ["method", *(metric.key for metric in metrics)]
        return Table("", title, keys, ["method", *(metric.heading for metric in metrics)], rows)

    def _cell(self, metric: MetricColumn, evaluation: RunEvaluation) -> TableCell:
        cell = number_cell(metric.value(evaluation), metric.digits, metric.display_factor)
        relative = (
            ratio(metric, evaluation, self.reference_evaluation)
            if metric.key in DISPLAYED_RATIO_KEYS
            else None
        )
        return cell if relative is None else replace(cell, text=f"{cell.text} ({relative:.2f})")


def bench_table(results: Sequence[RelativeResults]) -> Table:
    """Return the table for scripts: one row per recording, frame step and method; all metrics."""
    run_keys = ["sequence", "every", "frames", "method", "state", "error"]
    metric_keys = [metric.key for metric in ALL_METRICS]
    ratio_keys = [f"{metric.key}_ratio" for metric in RATIO_METRICS]
    loop_closure_metrics = (
        (*LOOP_CLOSURE_METRICS, LOOP_CLOSURE_CPU_METRIC)
        if any(entry.results.has_loop_closure for entry in results)
        else ()
    )
    rows = [
        [
            *_run_cells(relative_results.results, method, evaluation),
            *(number_cell(metric.value(evaluation), metric.digits) for metric in ALL_METRICS),
            *(
                number_cell(ratio(metric, evaluation, relative_results.reference_evaluation), 3)
                for metric in RATIO_METRICS
            ),
            *(
                number_cell(metric.value(evaluation), metric.digits)
                for metric in loop_closure_metrics
            ),
        ]
        for relative_results in results
        for method, evaluation in relative_results.results.evaluations.items()
    ]
    keys = [*run_keys, *metric_keys, *ratio_keys, *(metric.key for metric in loop_closure_metrics)]
    return Table("bench", "All metrics", keys, keys, rows)


def _run_cells(result: SequenceResults, method: str, evaluation: RunEvaluation) -> list[TableCell]:
    recording = result.recording
    return [
        text_cell(recording.folder.resolve().name),
        number_cell(recording.frame_selection.step, 0),
        number_cell(len(recording.frame_stamps_s), 0),
        text_cell(method),
        text_cell(evaluation.outcome.state),
        text_cell(evaluation.outcome.error),
    ]


def _name_cell(method: str, evaluation: RunEvaluation) -> TableCell:
    """Return the method's name, with the state if the run has no result."""
    return text_cell(
        method, method if evaluation.is_done else f"{method}: {evaluation.outcome.state}"
    )

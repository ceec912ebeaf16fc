"""Tables of the bench: two for people, one for scripts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from vo_service.tools.benchmark.evaluate_run import RunEvaluation
from vo_service.tools.benchmark.report.bench_metrics import (
    ALL_METRICS,
    CPU_METRICS,
    ERROR_METRICS,
    LOOP_CLOSURE_CPU_METRIC,
    LOOP_CLOSURE_METRICS,
    MEMORY_METRIC,
    RATIO_METRICS,
    ROBUSTNESS_METRICS,
    WALL_METRICS,
    ratio,
)
from vo_service.tools.benchmark.report.table import (
    MetricColumn,
    Table,
    TableCell,
    number_cell,
    text_cell,
)
from vo_service.tools.benchmark.results import SequenceResults

# These columns show a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


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

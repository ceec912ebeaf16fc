"""The tables of the bench: two for people, one for scripts."""

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

# With a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


@dataclass(frozen=True)
class RelativeResults:
    """The results of one recording at one rate, beside those of the method `against`."""

    results: SequenceResults
    reference_method: str

    @property
    def reference_evaluation(self) -> RunEvaluation:
        """What the others are divided by."""
        return self.results.evaluations[self.reference_method]

    @property
    def title(self) -> str:
        """Which frames these are."""
        recording = self.results.recording
        every = recording.frame_selection.step
        frames = f"{len(recording.frame_stamps_s)} frames in {recording.duration_s:.1f} s"
        used = "every frame" if every == 1 else f"1 frame in {every}"
        truth = "" if recording.truth is not None else ", no groundtruth.txt: errors are not known"
        return f"{recording.folder.resolve().name}, {used}: {frames}{truth}"

    def error_table(self) -> Table:
        """How far off, how often lost."""
        title = f"{self.title}; in () times that of {self.reference_method}"
        loops = LOOP_CLOSURE_METRICS if self.results.has_loop_closure else ()
        return self._table(title, (*ERROR_METRICS, *ROBUSTNESS_METRICS, *loops))

    def cost_table(self) -> Table:
        """Time a frame, and memory."""
        loops = (LOOP_CLOSURE_CPU_METRIC,) if self.results.has_loop_closure else ()
        return self._table("", (*CPU_METRICS, *WALL_METRICS, MEMORY_METRIC, *loops))

    def _table(self, title: str, metrics: Sequence[MetricColumn]) -> Table:
        rows = [
            [_name_cell(method, judged), *(self._cell(metric, judged) for metric in metrics)]
            for method, judged in self.results.evaluations.items()
        ]
        keys = ["method", *(metric.key for metric in metrics)]
        return Table("", title, keys, ["method", *(metric.heading for metric in metrics)], rows)

    def _cell(self, metric: MetricColumn, evaluation: RunEvaluation) -> TableCell:
        cell = number_cell(metric.value(evaluation), metric.digits, metric.display_factor)
        times = (
            ratio(metric, evaluation, self.reference_evaluation)
            if metric.key in DISPLAYED_RATIO_KEYS
            else None
        )
        return cell if times is None else replace(cell, text=f"{cell.text} ({times:.2f})")


def bench_table(results: Sequence[RelativeResults]) -> Table:
    """For scripts: one row a recording, rate and method, every figure and every ratio."""
    about = ["sequence", "every", "frames", "method", "state", "trouble"]
    figures = [metric.key for metric in ALL_METRICS]
    times = [f"{metric.key}_ratio" for metric in RATIO_METRICS]
    loops = (
        (*LOOP_CLOSURE_METRICS, LOOP_CLOSURE_CPU_METRIC)
        if any(each.results.has_loop_closure for each in results)
        else ()
    )
    rows = [
        [
            *_run_cells(ranking.results, method, judged),
            *(number_cell(metric.value(judged), metric.digits) for metric in ALL_METRICS),
            *(
                number_cell(ratio(metric, judged, ranking.reference_evaluation), 3)
                for metric in RATIO_METRICS
            ),
            *(number_cell(metric.value(judged), metric.digits) for metric in loops),
        ]
        for ranking in results
        for method, judged in ranking.results.evaluations.items()
    ]
    keys = [*about, *figures, *times, *(metric.key for metric in loops)]
    return Table("bench", "Every figure", keys, keys, rows)


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
    """A run without a result says so."""
    return text_cell(
        method, method if evaluation.is_done else f"{method}: {evaluation.outcome.state}"
    )

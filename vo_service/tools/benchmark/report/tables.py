"""Tables of the results: one set of metrics, as text for people and as CSV for scripts."""

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, TextIO

import numpy as np

from drivers.core.geometry import Array
from vo_service.terminal import make_console
from vo_service.tools.benchmark import FrameLog
from vo_service.tools.benchmark.recordings import ALL_FRAMES, BenchmarkRecording
from vo_service.tools.benchmark.results import RunEvaluation, SequenceResults

if TYPE_CHECKING:
    from rich.text import Text

# A table that is wider than the terminal is not cut.
MAX_WIDTH = 1000


@dataclass(frozen=True)
class TableCell:
    """Cell with a value for scripts (None if not known) and a text for people."""

    value: float | str | None
    text: str
    is_best: bool = False


@dataclass(frozen=True)
class Table:
    """Table with named columns.

    Attributes:
        title: Title for people; "" for none.
        keys: Column names for scripts.
        headings: Column headings for people.
        rows: Cells by row.
    """

    title: str
    keys: Sequence[str]
    headings: Sequence[str]
    rows: Sequence[Sequence[TableCell]]

    def as_csv(self) -> str:
        """Return comma-separated values with full precision; empty if not known."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.keys)
        for row in self.rows:
            writer.writerow("" if cell.value is None else cell.value for cell in row)
        return text.getvalue()

    def write(self, stream: TextIO) -> None:
        """Write aligned columns below the title; on a terminal, the best cells are bold."""
        from rich import table  # slow to import

        columns = [
            table.Column(heading, justify="right" if number else "left", no_wrap=True)
            for number, heading in enumerate(self.headings)
        ]
        grid = table.Table(
            *columns, box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold"
        )
        for row in self.rows:
            grid.add_row(*(_format_cell(cell) for cell in row))
        console = make_console(stream, MAX_WIDTH)
        console.print(self.title, style="bold")
        console.print(grid)


def _format_cell(cell: TableCell) -> "Text":
    from rich.text import Text

    return Text(cell.text, style="bold green" if cell.is_best else "")


def number_cell(value: float | None, digits: int, display_factor: float = 1.0) -> TableCell:
    """Make a cell of a number; digits and factor apply to the displayed text only.

    Args:
        value: The number; None if not known.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed number.
    """
    if value is None:
        return TableCell(None, "-")
    return TableCell(value, f"{display_factor * value:.{digits}f}")


def text_cell(text: str) -> TableCell:
    """Make a cell of a text."""
    return TableCell(text, text)


@dataclass(frozen=True)
class MetricColumn:
    """Column of a metric.

    Attributes:
        key: Name for scripts.
        heading: Heading for people.
        value: Function that returns the metric of a run; None if not known.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed value.
    """

    key: str
    heading: str
    value: Callable[[RunEvaluation], float | None]
    digits: int
    display_factor: float = 1.0

    def cell(self, evaluation: RunEvaluation) -> TableCell:
        """Return the cell of a run."""
        return number_cell(self.value(evaluation), self.digits, self.display_factor)

    def ratio(self, evaluation: RunEvaluation, reference: RunEvaluation | None) -> float | None:
        """Return the ratio to the baseline method's value, or None if not known.

        Args:
            evaluation: The run.
            reference: The run of the baseline method; None without.
        """
        value = self.value(evaluation)
        reference_value = None if reference is None else self.value(reference)
        return value / reference_value if value is not None and reference_value else None


def _attribute_of(part: str, attribute: str) -> Callable[[RunEvaluation], float | None]:
    """Return a function for an attribute of a part of an evaluation; None if it has no such part.

    Args:
        part: Path of the part, which may be None.
        attribute: The attribute.
    """
    find_part = attrgetter(part)

    def value(evaluation: RunEvaluation) -> float | None:
        found = find_part(evaluation)
        number: float | None = None if found is None else getattr(found, attribute)
        return number

    return value


def _error(key: str, heading: str) -> MetricColumn:
    digits, display_factor = (2, 1e3) if key.endswith("_m") else (3, 1.0)
    return MetricColumn(key, heading, _attribute_of("evaluation", key), digits, display_factor)


def _optimized_error(key: str, heading: str) -> MetricColumn:
    value = _attribute_of("optimized_evaluation", key)
    return MetricColumn(f"optimized_{key}", f"optimized {heading}", value, 2, 1e3)


def _loop_closure(key: str, heading: str, attribute: str, digits: int = 0) -> MetricColumn:
    value = _attribute_of("outcome.run.loop_closure", attribute)
    return MetricColumn(key, heading, value, digits)


def _of_run(key: str, heading: str, digits: int = 0) -> MetricColumn:
    """Return the column of an attribute of a complete run."""
    run_value = attrgetter(key)
    return MetricColumn(
        key,
        heading,
        lambda evaluation: run_value(evaluation.outcome.run) if evaluation.is_done else None,
        digits,
    )


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


GLOBAL_ERROR = _error("mean_global_error_m", "global mm")
ERRORS = (
    _error("ate_rmse_m", "ATE mm"),
    GLOBAL_ERROR,
    _error("rpe_frame_m", "RPE mm"),
    _error("rpe_frame_deg", "RPE °"),
    _error("rpe_1s_m", "RPE 1 s mm"),
    _error("rpe_1s_deg", "RPE 1 s °"),
)
COVERAGE = MetricColumn("coverage", "coverage %", attrgetter("coverage"), 1, 100.0)
ROBUSTNESS = (
    COVERAGE,
    _of_run("failed", "lost"),
    _of_run("new_epochs", "epochs"),
    MetricColumn("gross_errors", "gross", attrgetter("gross_errors"), 0),
    MetricColumn("steps", "of", attrgetter("steps"), 0),
)
COST = (
    *_time_metrics("cpu_ms", "CPU ms", lambda frames: frames.cpu_ms),
    *_time_metrics("wall_ms", "wall ms", lambda frames: frames.wall_ms),
    _of_run("memory_mb", "memory MB"),
)
TOTAL_TIMES = (_of_run("cpu_s", "CPU s", 2), _of_run("wall_s", "wall s", 2))
# Additional columns with loop closure.
LOOP_CLOSURE = (
    _optimized_error("ate_rmse_m", "ATE mm"),
    _optimized_error("mean_global_error_m", "global mm"),
    _loop_closure("map_keyframes", "keyframes", "map_keyframes"),
    _loop_closure("loop_closures", "loops", "loop_closures"),
)
LOOP_CLOSURE_COST = _loop_closure("loop_closure_ms_per_frame", "loops ms", "cpu_ms_per_frame", 2)
METRICS = (*ERRORS, *ROBUSTNESS, *COST, *TOTAL_TIMES)
# Metrics whose ratio to the baseline method is meaningful.
RATIO_METRICS = (*ERRORS, *COST)
# These columns show a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


def metric_values(result: SequenceResults, method: str) -> dict[str, object]:
    """Return every metric by its key, and under `ratios` those relative to the baseline method.

    Args:
        result: Results of the recording.
        method: The method.
    """
    evaluation, reference = result.evaluations[method], result.reference
    ratios = () if reference is None else RATIO_METRICS
    return {
        **{metric.key: metric.value(evaluation) for metric in _metrics(result.has_loop_closure)},
        "ratios": {metric.key: metric.ratio(evaluation, reference) for metric in ratios},
    }


def _metrics(has_loop_closure: bool) -> tuple[MetricColumn, ...]:
    return (*METRICS, *LOOP_CLOSURE, LOOP_CLOSURE_COST) if has_loop_closure else METRICS


def error_table(result: SequenceResults) -> Table:
    """Return the table of errors and robustness; the title names recording and baseline."""
    title = result.recording.summary
    if result.recording.truth is None:
        title += ", no groundtruth.txt, so errors are not known"
    if result.reference_method is not None:
        title += f"; in () relative to {result.reference_method}"
    loop_closure = LOOP_CLOSURE if result.has_loop_closure else ()
    return _method_table(title, result, (*ERRORS, *ROBUSTNESS, *loop_closure))


def cost_table(result: SequenceResults) -> Table:
    """Return the table of times per frame and memory."""
    loop_closure = (LOOP_CLOSURE_COST,) if result.has_loop_closure else ()
    return _method_table("", result, (*COST, *loop_closure))


def _method_table(title: str, result: SequenceResults, metrics: Sequence[MetricColumn]) -> Table:
    """Return a table with one row per method; the smallest errors are marked."""
    best = {metric.key: result.best_method(metric.value) for metric in ERRORS}
    rows = [
        [
            text_cell(method if evaluation.is_done else f"{method}: {evaluation.outcome.state}"),
            *(
                replace(
                    _cell_with_ratio(metric, evaluation, result.reference),
                    is_best=best.get(metric.key) == method,
                )
                for metric in metrics
            ),
        ]
        for method, evaluation in result.evaluations.items()
    ]
    keys = ["method", *(metric.key for metric in metrics)]
    return Table(title, keys, ["method", *(metric.heading for metric in metrics)], rows)


def _cell_with_ratio(
    metric: MetricColumn, evaluation: RunEvaluation, reference: RunEvaluation | None
) -> TableCell:
    cell, ratio = metric.cell(evaluation), metric.ratio(evaluation, reference)
    is_shown = ratio is not None and metric.key in DISPLAYED_RATIO_KEYS
    return replace(cell, text=f"{cell.text} ({ratio:.2f})") if is_shown else cell


RUN_KEYS = ("sequence", "every", "method")


def _run_cells(result: SequenceResults, method: str) -> list[TableCell]:
    recording = result.recording
    every = number_cell(recording.frame_selection.step, 0)
    return [text_cell(recording.folder_name), every, text_cell(method)]


def metrics_table(results: Sequence[SequenceResults]) -> Table:
    """Return the table for scripts: all metrics and ratios, one row per run."""
    metrics = _metrics(any(result.has_loop_closure for result in results))
    ratios = RATIO_METRICS if any(result.reference for result in results) else ()
    rows = [
        [
            *_run_cells(result, method),
            number_cell(len(result.recording.frame_stamps_s), 0),
            *(metric.cell(evaluation) for metric in metrics),
            *(number_cell(metric.ratio(evaluation, result.reference), 3) for metric in ratios),
            text_cell(evaluation.outcome.state),
            text_cell(evaluation.outcome.error),
        ]
        for result in results
        for method, evaluation in result.evaluations.items()
    ]
    metric_keys = [metric.key for metric in metrics]
    ratio_keys = [f"{metric.key}_ratio" for metric in ratios]
    keys = [*RUN_KEYS, "frames", *metric_keys, *ratio_keys, "state", "error"]
    return Table("All metrics", keys, keys, rows)


def gap_table(results: Sequence[SequenceResults]) -> Table:
    """Return every gap of every recording with the result of each method that has one."""
    keys = [*RUN_KEYS, "at_s", "length_s", "across", "error_m", "error_deg"]
    head = [*RUN_KEYS, "at s", "pause s", "result", "error mm", "error °"]
    rows = [
        [
            *_run_cells(result, method),
            number_cell(gap.begin_s - float(result.recording.frame_stamps_s[0]), 2),
            number_cell(gap.length_s, 2),
            text_cell(str(evaluation.gap_outcomes[k])),
            number_cell(None if error is None else float(error.translation_m[0]), 2, 1e3),
            number_cell(None if error is None else float(error.rotation_deg[0]), 3),
        ]
        for result in results
        for k, gap in enumerate(result.recording.gaps)
        for method, evaluation in result.evaluations.items()
        if evaluation.is_done
        for error in evaluation.gap_errors[k : k + 1]
    ]
    return Table("Pauses", keys, head, rows)


def lost_frames_table(result: SequenceResults) -> Table:
    """Return the reasons for lost frames, the most frequent first."""
    rows = [
        [text_cell(method), text_cell(reason), number_cell(count, 0)]
        for method, evaluation in result.evaluations.items()
        for reason, count in evaluation.lost_reasons
    ]
    head = ["method", "why", "frames"]
    return Table("Lost frames", head, head, rows)


@dataclass(frozen=True)
class PublishedResult:
    """Published result of one method on one sequence."""

    mean_global_error_m: float
    time_s: float


# Tables I and II of Fontes and Maia.
PUBLISHED_RESULTS: Mapping[str, Mapping[str, PublishedResult]] = {
    "floor": {
        "surf": PublishedResult(0.05, 458),
        "icp": PublishedResult(0.12, 621),
        "sfm": PublishedResult(0.51, 950),
    },
    "teddy": {
        "surf": PublishedResult(0.13, 953),
        "icp": PublishedResult(0.74, 1155),
        "sfm": PublishedResult(0.22, 1430),
    },
}
_SEQUENCE_PATTERN = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)1[_/-](floor|teddy)$", re.IGNORECASE)


def find_published_results(recording: BenchmarkRecording) -> Mapping[str, PublishedResult]:
    """Return results by method; empty unless it is named as a published sequence, and complete."""
    name = "/".join(recording.folder.resolve().parts[-2:])
    match = _SEQUENCE_PATTERN.search(name)
    is_complete = recording.frame_selection == ALL_FRAMES
    return PUBLISHED_RESULTS[match[1].lower()] if match and is_complete else {}


def paper_table(results: Sequence[SequenceResults]) -> Table:
    """Return the paper's errors and times beside ours, for the recordings of the paper."""
    metrics = (COVERAGE, GLOBAL_ERROR, *TOTAL_TIMES)
    rows = [
        [
            text_cell(result.recording.folder_name),
            text_cell(method),
            *(metric.cell(evaluation) for metric in metrics),
            number_cell(known.mean_global_error_m if known else None, 0, 1e3),
            number_cell(known.time_s if known else None, 0),
        ]
        for result in results
        for published in [find_published_results(result.recording)]
        if published
        for method, evaluation in result.evaluations.items()
        for known in [published.get(method)]
    ]
    paper_keys = ["paper_mean_global_error_m", "paper_time_s"]
    keys = ["sequence", "method", *(metric.key for metric in metrics), *paper_keys]
    head = ["sequence", "method", *(metric.heading for metric in metrics)]
    title = "Mean global error and processing time beside the paper's (its Tables I and II)"
    return Table(title, keys, [*head, "paper: global mm", "paper: s"], rows)

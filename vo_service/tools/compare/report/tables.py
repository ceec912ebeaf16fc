"""Tables of the results, as text for people and as CSV for scripts."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TextIO

from vo_service.terminal import make_console
from vo_service.tools.compare.recordings import ALL_FRAMES, BenchmarkRecording
from vo_service.tools.compare.report.metrics import (
    COST,
    COVERAGE,
    ERRORS,
    GLOBAL_ERROR,
    LOOP_CLOSURE,
    LOOP_CLOSURE_COST,
    RATIO_METRICS,
    ROBUSTNESS,
    TOTAL_TIMES,
    Metric,
    all_metrics,
)
from vo_service.tools.compare.results import RunEvaluation, SequenceResults

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
        from rich.text import Text

        columns = [
            table.Column(heading, justify="right" if number else "left", no_wrap=True)
            for number, heading in enumerate(self.headings)
        ]
        grid = table.Table(
            *columns, box=None, pad_edge=False, padding=(0, 3, 0, 0), header_style="bold"
        )
        for row in self.rows:
            grid.add_row(*(Text(cell.text, "bold green" if cell.is_best else "") for cell in row))
        console = make_console(stream, MAX_WIDTH)
        console.print(self.title, style="bold")
        console.print(grid)


def number_cell(value: float | None, digits: int, display_factor: float = 1.0) -> TableCell:
    """Make a cell of a number, None if not known.

    The digits after the decimal point and the factor apply to the displayed text only.
    """
    if value is None:
        return TableCell(None, "-")
    return TableCell(value, f"{display_factor * value:.{digits}f}")


def text_cell(text: str) -> TableCell:
    """Make a cell of a text."""
    return TableCell(text, text)


# These columns show a ratio in parentheses; the other ratios are in the files.
DISPLAYED_RATIO_KEYS = {"ate_rmse_m", "mean_global_error_m", "rpe_1s_m", "cpu_ms_mean", "memory_mb"}


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


def _method_table(title: str, result: SequenceResults, metrics: Sequence[Metric]) -> Table:
    """Return a table with one row per method; the smallest errors are marked."""
    best = {metric.key: result.best_method(metric.value) for metric in ERRORS}
    rows = [
        [
            text_cell(method if evaluation.is_done else f"{method}: {evaluation.outcome.state}"),
            *(
                replace(
                    _metric_cell(metric, evaluation, result.reference),
                    is_best=best.get(metric.key) == method,
                )
                for metric in metrics
            ),
        ]
        for method, evaluation in result.evaluations.items()
    ]
    keys = ["method", *(metric.key for metric in metrics)]
    return Table(title, keys, ["method", *(metric.heading for metric in metrics)], rows)


def _metric_cell(
    metric: Metric, evaluation: RunEvaluation, reference: RunEvaluation | None = None
) -> TableCell:
    """Return the cell of a metric, with its ratio to that of the baseline method."""
    cell = number_cell(metric.value(evaluation), metric.digits, metric.display_factor)
    ratio = metric.ratio(evaluation, reference)
    is_shown = ratio is not None and metric.key in DISPLAYED_RATIO_KEYS
    return replace(cell, text=f"{cell.text} ({ratio:.2f})") if is_shown else cell


RUN_KEYS = ("sequence", "every", "method")


def _run_cells(result: SequenceResults, method: str) -> list[TableCell]:
    recording = result.recording
    every = number_cell(recording.frame_selection.step, 0)
    return [text_cell(recording.folder_name), every, text_cell(method)]


def metrics_table(results: Sequence[SequenceResults]) -> Table:
    """Return the table for scripts: all metrics and ratios, one row per run."""
    metrics = all_metrics(any(result.has_loop_closure for result in results))
    ratios = RATIO_METRICS if any(result.reference for result in results) else ()
    rows = [
        [
            *_run_cells(result, method),
            number_cell(len(result.recording.frame_stamps_s), 0),
            *(_metric_cell(metric, evaluation) for metric in metrics),
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


class PublishedResult(NamedTuple):
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
            *(_metric_cell(metric, evaluation) for metric in metrics),
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

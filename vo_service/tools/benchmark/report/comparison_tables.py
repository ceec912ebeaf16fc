"""Tables of a comparison: the paper's two with its published results, and all other metrics."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vo_service.tools.benchmark.report import (
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


@dataclass(frozen=True)
class PublishedResult:
    """Published result of one method on one sequence."""

    mean_global_error_m: float
    time_s: float


@dataclass(frozen=True)
class MethodDescription:
    """Name and description of a method for readers."""

    name: str
    description: str


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
METHOD_DESCRIPTIONS = {
    "surf": MethodDescription(
        "SURF (proposed)",
        "color and depth: SURF features of a frame are matched with those of the previous frame. "
        "RANSAC selects the matches that agree on one motion, and singular value decomposition "
        "fits it. This is the method that the paper proposes.",
    ),
    "icp": MethodDescription(
        "ICP",
        "depth only: the surface in a frame is aligned with that of an earlier frame (iterative "
        "closest point). It needs structure: if it sees hardly more than one plane, it gives no "
        "pose.",
    ),
    "sfm": MethodDescription(
        "SfM",
        "color only: features are tracked from frame to frame, and give motion and points together "
        "(structure from motion). Color alone has no scale: the first scale is given, and it may "
        "drift from there.",
    ),
    "direct": MethodDescription(
        "Direct",
        "color and depth: brightness and depth of every frame are aligned with those of a "
        "keyframe, which stays as long as most of it is in view; each sensor row has its own "
        "time. Not in the paper; this is the default of the service.",
    ),
}
_SEQUENCE_PATTERN = re.compile(r"(?<![a-z0-9])(?:freiburg|fr)1[_/-](floor|teddy)$", re.IGNORECASE)


def find_published_results(folder: Path) -> Mapping[str, PublishedResult]:
    """Return results by method; empty unless the folder is named as a published sequence."""
    name = "/".join(folder.resolve().parts[-2:])
    match = _SEQUENCE_PATTERN.search(name)
    return PUBLISHED_RESULTS[match[1].lower()] if match else {}


def describe_method(method: str) -> MethodDescription:
    """Return the description of a method; unknown methods get a general one."""
    return METHOD_DESCRIPTIONS.get(method, MethodDescription(method.upper(), "see docs/design."))


MM_PER_M = 1e3
ERROR_METRIC = MetricColumn(
    "mean_global_error_m", "mm", from_evaluation("mean_global_error_m"), 2, MM_PER_M
)
CPU_METRIC = MetricColumn("cpu_s", "CPU s", from_run(lambda run: run.cpu_s), 2)
WALL_METRIC = MetricColumn("wall_s", "wall s", from_run(lambda run: run.wall_s), 2)
ALL_METRICS = (
    MetricColumn("coverage", "coverage %", lambda evaluation: evaluation.coverage, 1, 100.0),
    MetricColumn("failed", "lost frames", from_run(lambda run: run.failed), 0),
    MetricColumn("new_epochs", "new epochs", from_run(lambda run: run.new_epochs), 0),
    MetricColumn("gross_errors", "gross errors", lambda evaluation: evaluation.gross_errors, 0),
    ERROR_METRIC,
    MetricColumn("ate_rmse_m", "ATE mm", from_evaluation("ate_rmse_m"), 2, MM_PER_M),
    MetricColumn("rpe_frame_m", "RPE frame mm", from_evaluation("rpe_frame_m"), 2, MM_PER_M),
    MetricColumn("rpe_frame_deg", "RPE frame °", from_evaluation("rpe_frame_deg"), 3),
    MetricColumn("rpe_1s_m", "RPE 1 s mm", from_evaluation("rpe_1s_m"), 2, MM_PER_M),
    MetricColumn("rpe_1s_deg", "RPE 1 s °", from_evaluation("rpe_1s_deg"), 3),
    MetricColumn(
        "cpu_ms_per_frame", "CPU ms a frame",
        from_run(lambda run: run.cpu_ms_per_frame), 1,
    ),
    CPU_METRIC,
    WALL_METRIC,
    MetricColumn("memory_mb", "memory MB", from_run(lambda run: run.memory_mb), 0),
)  # fmt: skip
LOOP_CLOSURE_METRICS = (
    MetricColumn("ate_rmse_m", "ATE mm", from_evaluation("ate_rmse_m"), 2, MM_PER_M),
    MetricColumn(
        "optimized_ate_rmse_m", "optimized ATE mm",
        from_optimized_evaluation("ate_rmse_m"), 2, MM_PER_M,
    ),
    ERROR_METRIC,
    MetricColumn(
        "optimized_mean_global_error_m", "optimized global error mm",
        from_optimized_evaluation("mean_global_error_m"), 2, MM_PER_M,
    ),
    MetricColumn("map_keyframes", "keyframes", from_loop_closure(lambda run: run.map_keyframes), 0),
    MetricColumn("loop_closures", "loops", from_loop_closure(lambda run: run.loop_closures), 0),
    MetricColumn(
        "loop_closure_ms_per_frame", "loops ms a frame",
        from_loop_closure(lambda run: run.cpu_ms_per_frame), 2,
    ),
)  # fmt: skip
# If the coverage is lower, it is shown beside the error.
MIN_FULL_COVERAGE = 0.99
HEADINGS = {ERROR_METRIC.key: "mean global error mm"}


def error_table(results: Sequence[SequenceResults]) -> Table:
    """Return Table I: the mean global error."""
    return Table(
        "table_1_mean_global_error",
        "Table I: mean global error, in millimeters",
        *_columns_by_method(
            results, (ERROR_METRIC,), lambda published: published.mean_global_error_m
        ),
    )


def time_table(results: Sequence[SequenceResults]) -> Table:
    """Return Table II: the processing time."""
    return Table(
        "table_2_processing_time",
        "Table II: processing time of the whole recording, in seconds",
        *_columns_by_method(results, (CPU_METRIC, WALL_METRIC), lambda published: published.time_s),
    )


def metrics_table(results: Sequence[SequenceResults]) -> Table:
    """Return all metrics, one row per run."""
    return _table_by_run("metrics", "All metrics", results, ALL_METRICS)


def loop_closure_table(results: Sequence[SequenceResults]) -> Table:
    """Return the effect of loop closure, one row per run."""
    return _table_by_run("loop_closures", "Loop closure", results, LOOP_CLOSURE_METRICS)


def _table_by_run(
    name: str, title: str, results: Sequence[SequenceResults], metrics: Sequence[MetricColumn]
) -> Table:
    head = ["sequence", "method", *(HEADINGS.get(m.key, m.heading) for m in metrics), "state"]
    keys = ["sequence", "method", *(metric.key for metric in metrics), "state", "error"]
    rows = [
        [
            text_cell(result.recording.name),
            text_cell(method, describe_method(method).name),
            *(_metric_cell(evaluation, metric) for metric in metrics),
            text_cell(evaluation.outcome.state),
            text_cell(evaluation.outcome.error),
        ]
        for result in results
        for method, evaluation in result.evaluations.items()
    ]
    return Table(name, title, keys, [*head, "error"], rows)


def gap_table(results: Sequence[SequenceResults]) -> Table:
    """Return every gap of every recording with the result of each method."""
    head = ["sequence", "at s", "pause s", "method", "result", "error mm", "error °"]
    keys = ["sequence", "at_s", "length_s", "method", "across", "error_m", "error_deg"]
    return Table("gaps", "Pauses", keys, head, [row for r in results for row in gap_rows(r)])


def gap_rows(result: SequenceResults) -> list[list[TableCell]]:
    """Return the rows of one recording; methods without a result have none."""
    rows = []
    for k, gap in enumerate(result.recording.gaps):
        at_s = gap.begin_s - float(result.recording.frame_stamps_s[0])
        for method, evaluation in result.evaluations.items():
            if not evaluation.is_done:
                continue
            error = evaluation.gap_errors[k]
            rows.append(
                [
                    text_cell(result.recording.name),
                    number_cell(at_s, 2),
                    number_cell(gap.length_s, 2),
                    text_cell(method, describe_method(method).name),
                    text_cell(str(evaluation.gap_outcomes[k])),
                    number_cell(
                        None if error is None else float(error.translation_m[0]), 2, MM_PER_M
                    ),
                    number_cell(None if error is None else float(error.rotation_deg[0]), 3),
                ]
            )
    return rows


def _columns_by_method(
    results: Sequence[SequenceResults],
    metrics: Sequence[MetricColumn],
    published_value: Callable[[PublishedResult], float],
) -> tuple[list[str], list[str], list[list[TableCell]]]:
    """Return keys, headings and rows: one row per recording, with columns for each method."""
    methods = list(results[0].evaluations)
    paper = [find_published_results(result.recording.folder) for result in results]
    known = [method for method in methods if any(method in published for published in paper)]
    keys = ["sequence", *(f"{method}_{m.key}" for method in methods for m in metrics)]
    head = ["sequence", *(_heading(method, m, metrics) for method in methods for m in metrics)]
    rows = []
    for result, published in zip(results, paper, strict=True):
        best = result.best_method(metrics[0].value)
        cells = [
            _cell_or_state(
                result.evaluations[method], metric, method == best and metric is metrics[0]
            )
            for method in methods
            for metric in metrics
        ]
        values = [
            published_value(published[method]) if method in published else None for method in known
        ]
        paper_cells = [number_cell(value, 0, metrics[0].display_factor) for value in values]
        rows.append([text_cell(result.recording.name), *cells, *paper_cells])
    keys += [f"paper_{method}" for method in known]
    return keys, head + [f"paper: {describe_method(method).name}" for method in known], rows


def _heading(method: str, metric: MetricColumn, metrics: Sequence[MetricColumn]) -> str:
    name = describe_method(method).name
    return name if len(metrics) == 1 else f"{name}, {metric.heading}"


def _cell_or_state(evaluation: RunEvaluation, metric: MetricColumn, is_best: bool) -> TableCell:
    """Return a cell of the paper's tables: metric and coverage, or the run's state."""
    if not evaluation.is_done:
        return TableCell(None, evaluation.outcome.state)
    cell = _metric_cell(evaluation, metric, is_best)
    coverage = 1.0 if evaluation.coverage is None else evaluation.coverage
    if coverage >= MIN_FULL_COVERAGE or metric is not ERROR_METRIC or cell.value is None:
        return cell
    return replace(cell, text=f"{cell.text} ({100 * coverage:.0f} %)")


def _metric_cell(
    evaluation: RunEvaluation, metric: MetricColumn, is_best: bool = False
) -> TableCell:
    return number_cell(metric.value(evaluation), metric.digits, metric.display_factor, is_best)

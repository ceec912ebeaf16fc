"""The tables of a comparison: the paper's two, and all other figures."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from vo_service.comparison.paper import PaperFigures, about, paper_figures
from vo_service.runs.judging import Judgement
from vo_service.runs.metric import Metric, corrected, evaluated, of_loops, of_run
from vo_service.runs.results import SequenceResults
from vo_service.runs.table import Cell, Table, number, words

MM = 1e3
ERROR = Metric("mean_global_error_m", "mm", evaluated("mean_global_error_m"), 2, MM)
CPU = Metric("cpu_s", "CPU s", of_run(lambda run: run.cpu_s), 2)
WALL = Metric("wall_s", "wall s", of_run(lambda run: run.wall_s), 2)
METRICS = (
    Metric("coverage", "coverage %", lambda judged: judged.coverage, 1, 100.0),
    Metric("failed", "lost frames", of_run(lambda run: run.failed), 0),
    Metric("new_epochs", "new epochs", of_run(lambda run: run.new_epochs), 0),
    Metric("gross_errors", "gross errors", lambda judged: judged.gross_errors, 0),
    ERROR,
    Metric("ate_rmse_m", "ATE mm", evaluated("ate_rmse_m"), 2, MM),
    Metric("rpe_frame_m", "RPE frame mm", evaluated("rpe_frame_m"), 2, MM),
    Metric("rpe_frame_deg", "RPE frame °", evaluated("rpe_frame_deg"), 3),
    Metric("rpe_1s_m", "RPE 1 s mm", evaluated("rpe_1s_m"), 2, MM),
    Metric("rpe_1s_deg", "RPE 1 s °", evaluated("rpe_1s_deg"), 3),
    Metric(
        "cpu_ms_per_frame", "CPU ms a frame",
        of_run(lambda run: run.cpu_ms_per_frame), 1,
    ),
    CPU,
    WALL,
    Metric("memory_mb", "memory MB", of_run(lambda run: run.memory_mb), 0),
)  # fmt: skip
LOOPS = (
    Metric("ate_rmse_m", "ATE mm", evaluated("ate_rmse_m"), 2, MM),
    Metric("corrected_ate_rmse_m", "corrected ATE mm", corrected("ate_rmse_m"), 2, MM),
    ERROR,
    Metric(
        "corrected_mean_global_error_m", "corrected global error mm",
        corrected("mean_global_error_m"), 2, MM,
    ),
    Metric("places", "places", of_loops(lambda loops: loops.places), 0),
    Metric("loops", "loops", of_loops(lambda loops: loops.loops), 0),
    Metric("loops_ms_per_frame", "loops ms a frame", of_loops(lambda loops: loops.cpu_ms), 2),
)  # fmt: skip
# Of the frames: where fewer have a pose, the share stands beside the figure.
WHOLE = 0.99
HEADINGS = {ERROR.key: "mean global error mm"}


def error_table(results: Sequence[SequenceResults]) -> Table:
    """Table I: the mean global error."""
    return Table(
        "table_1_mean_global_error",
        "Table I: mean global error, in millimetres",
        *_by_method(results, (ERROR,), lambda figures: figures.mean_global_error_m),
    )


def time_table(results: Sequence[SequenceResults]) -> Table:
    """Table II: the processing time."""
    return Table(
        "table_2_processing_time",
        "Table II: processing time of the whole recording, in seconds",
        *_by_method(results, (CPU, WALL), lambda figures: figures.time_s),
    )


def metrics_table(results: Sequence[SequenceResults]) -> Table:
    """Every figure, one row a run."""
    return _by_run("metrics", "All figures", results, METRICS)


def loops_table(results: Sequence[SequenceResults]) -> Table:
    """What loops have gained, one row a run."""
    return _by_run("loops", "With loops", results, LOOPS)


def _by_run(
    name: str, title: str, results: Sequence[SequenceResults], metrics: Sequence[Metric]
) -> Table:
    head = ["sequence", "method", *(HEADINGS.get(m.key, m.heading) for m in metrics), "state"]
    keys = ["sequence", "method", *(metric.key for metric in metrics), "state", "trouble"]
    rows = [
        [
            words(result.recording.name),
            words(method, about(method).name),
            *(_cell(judged, metric) for metric in metrics),
            words(judged.outcome.state),
            words(judged.outcome.trouble),
        ]
        for result in results
        for method, judged in result.judged.items()
    ]
    return Table(name, title, keys, [*head, "trouble"], rows)


def gap_table(results: Sequence[SequenceResults]) -> Table:
    """Every pause of every recording, and what each method did across it."""
    head = ["sequence", "at s", "pause s", "method", "across", "error mm", "error °"]
    keys = ["sequence", "at_s", "length_s", "method", "across", "error_m", "error_deg"]
    return Table("gaps", "Pauses", keys, head, [row for r in results for row in gap_rows(r)])


def gap_rows(result: SequenceResults) -> list[list[Cell]]:
    """Those of one recording; a method without a result has none."""
    rows = []
    for k, gap in enumerate(result.recording.gaps):
        at_s = gap.begin_s - float(result.recording.frames_s[0])
        for method, judged in result.judged.items():
            if not judged.is_done:
                continue
            jump = judged.jumps[k]
            rows.append(
                [
                    words(result.recording.name),
                    number(at_s, 2),
                    number(gap.length_s, 2),
                    words(method, about(method).name),
                    words(str(judged.crossings[k])),
                    number(None if jump is None else float(jump.translation_m[0]), 2, MM),
                    number(None if jump is None else float(jump.rotation_deg[0]), 3),
                ]
            )
    return rows


def _by_method(
    results: Sequence[SequenceResults],
    metrics: Sequence[Metric],
    papers: Callable[[PaperFigures], float],
) -> tuple[list[str], list[str], list[list[Cell]]]:
    """Keys, headings and rows: one row a recording, the methods beside each other."""
    methods = list(results[0].judged)
    paper = [paper_figures(result.recording.folder) for result in results]
    known = [method for method in methods if any(method in figures for figures in paper)]
    keys = ["sequence", *(f"{method}_{m.key}" for method in methods for m in metrics)]
    head = ["sequence", *(_heading(method, m, metrics) for method in methods for m in metrics)]
    rows = []
    for result, figures in zip(results, paper, strict=True):
        best = result.best(metrics[0].value)
        cells = [
            _cell_or_state(result.judged[method], metric, method == best and metric is metrics[0])
            for method in methods
            for metric in metrics
        ]
        theirs = [papers(figures[method]) if method in figures else None for method in known]
        beside = [number(value, 0, metrics[0].factor) for value in theirs]
        rows.append([words(result.recording.name), *cells, *beside])
    keys += [f"paper_{method}" for method in known]
    return keys, head + [f"paper: {about(method).name}" for method in known], rows


def _heading(method: str, metric: Metric, metrics: Sequence[Metric]) -> str:
    name = about(method).name
    return name if len(metrics) == 1 else f"{name}, {metric.heading}"


def _cell_or_state(judged: Judgement, metric: Metric, is_best: bool) -> Cell:
    """In the paper's tables a run without a result says so, and an error of how many frames."""
    if not judged.is_done:
        return Cell(None, judged.outcome.state)
    cell = _cell(judged, metric, is_best)
    share = 1.0 if judged.coverage is None else judged.coverage
    if share >= WHOLE or metric is not ERROR or cell.value is None:
        return cell
    return replace(cell, text=f"{cell.text} ({100 * share:.0f} %)")


def _cell(judged: Judgement, metric: Metric, is_best: bool = False) -> Cell:
    return number(metric.value(judged), metric.digits, metric.factor, is_best)

"""Report folder of a comparison: the HTML page, and each table and figure as a separate file."""

import base64
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from drivers.core.files import create_output_folder
from vo_service.terminal import Terminal
from vo_service.tools.benchmark import collect_versions
from vo_service.tools.benchmark.report import ComparisonMetadata, Table, number_cell, text_cell
from vo_service.tools.benchmark.report.comparison_tables import (
    MIN_FULL_COVERAGE,
    describe_method,
    error_table,
    find_published_results,
    gap_table,
    loop_closure_table,
    metrics_table,
    time_table,
)
from vo_service.tools.benchmark.report.figures import (
    NamedFigure,
    make_error_figures,
    make_trajectory_figures,
)
from vo_service.tools.benchmark.results import MIN_RANKED_COVERAGE, RunEvaluation, SequenceResults
from vo_service.tools.benchmark.run_cache import write_file

TEMPLATE_FILE = "comparison_report.html"


@dataclass(frozen=True)
class RenderedFigure:
    """Figure: its path relative to the page without suffix, its caption and its SVG."""

    path: str
    caption: str
    svg: bytes

    @property
    def link(self) -> str:
        """The path as the beginning of a URL."""
        return quote(self.path)

    @property
    def data_url(self) -> str:
        """URL of the SVG itself: as an image, because names in different SVGs could collide."""
        return f"data:image/svg+xml;base64,{base64.b64encode(self.svg).decode()}"


def render_page(
    results: Sequence[SequenceResults],
    figures: Mapping[str, Sequence[RenderedFigure]],
    metadata: ComparisonMetadata,
) -> str:
    """Return the page, which needs no other file and no network.

    Args:
        results: Results by recording.
        figures: Figures by the recording's name.
        metadata: Settings of the comparison.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined  # rarely used

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    functions = (
        *(describe_method, describe_recording, describe_rpe_without_gaps, summarize_sequence),
        *(error_table, gap_table, loop_closure_table, lost_frames_table, metrics_table, time_table),
    )
    environment.globals.update({function.__name__: function for function in functions})
    return environment.get_template(TEMPLATE_FILE).render(
        results=results,
        figures=figures,
        metadata=metadata,
        versions=collect_versions(),
        has_published_results=any(find_published_results(r.recording.folder) for r in results),
    )


def describe_recording(result: SequenceResults) -> str:
    """Return a sentence on the recording: frames, path, truth and pauses."""
    recording = result.recording
    path = "" if recording.path_m is None else f", a path of {recording.path_m:.1f} m"
    truth = "with ground truth" if recording.truth is not None else "without ground truth"
    pauses = len(recording.gaps)
    paused_s = sum(gap.length_s for gap in recording.gaps)
    count = "one pause" if pauses == 1 else f"{pauses} pauses"
    gaps = f", {count} of {paused_s:.1f} s in total" if pauses else ", no pauses"
    frames = len(recording.frame_stamps_s)
    return f"{frames} frames in {recording.duration_s:.1f} s{path}, {truth}{gaps}."


def lost_frames_table(result: SequenceResults) -> Table:
    """Return the reasons for lost frames, the most frequent first."""
    rows = [
        [text_cell(method, describe_method(method).name), text_cell(reason), number_cell(count, 0)]
        for method, evaluation in result.evaluations.items()
        for reason, count in evaluation.lost_reasons
    ]
    head = ["method", "why", "frames"]
    return Table("", "Lost frames", head, head, rows)


def summarize_sequence(result: SequenceResults) -> str:
    """Return sentences on the best method, low coverage and failed runs."""
    sentences = [
        _ranking_sentence(result),
        *_partial_coverage_sentences(result),
        *_failed_run_sentences(result),
    ]
    return " ".join(sentences)


def describe_rpe_without_gaps(result: SequenceResults) -> str:
    """Return a sentence on the RPE without pauses; "" if not known."""
    known = [
        f"{1e3 * evaluation.rpe_frame_without_gaps_m:.1f} mm for {describe_method(method).name}"
        for method, evaluation in result.evaluations.items()
        if evaluation.rpe_frame_without_gaps_m is not None
    ]
    return f" Without the pauses, the RPE of one frame is {', '.join(known)}." if known else ""


def _ranking_sentence(result: SequenceResults) -> str:
    known = sorted(
        (_error_m(evaluation), describe_method(method).name)
        for method, evaluation in result.evaluations.items()
        if evaluation.evaluation is not None and (evaluation.coverage or 0.0) >= MIN_RANKED_COVERAGE
    )
    if result.recording.truth is None:
        return "without ground truth, errors are not known."
    if not known:
        return "no method has poses for most of the frames."
    (smallest_m, best), *others = known
    if not others:
        return f"the mean global error of {best} is {1e3 * smallest_m:.2f} mm."
    rest = ", ".join(f"{name} {1e3 * error_m:.2f} mm" for error_m, name in others)
    return f"{best} has the smallest mean global error, {1e3 * smallest_m:.2f} mm; {rest}."


def _error_m(evaluation: RunEvaluation) -> float:
    assert evaluation.evaluation is not None
    return evaluation.evaluation.mean_global_error_m


def _partial_coverage_sentences(result: SequenceResults) -> list[str]:
    """Return a sentence for each method with incomplete coverage."""
    return [
        f"{describe_method(method).name} has poses for only "
        f"{100 * evaluation.coverage:.0f} % of the frames."
        for method, evaluation in result.evaluations.items()
        if evaluation.coverage is not None and evaluation.coverage < MIN_FULL_COVERAGE
    ]


def _failed_run_sentences(result: SequenceResults) -> list[str]:
    return [
        f"{describe_method(method).name} has no result ({evaluation.outcome.state})."
        for method, evaluation in result.evaluations.items()
        if not evaluation.is_done
    ]


PAGE_FILE, DATA_FILE, CONFIG_FILE = "report.html", "report.json", "config.toml"


@dataclass(frozen=True)
class ComparisonReport:
    """Path of the page, and all metrics as one object."""

    page: Path
    content: dict[str, Any]


def write_comparison_report(
    folder: Path,
    results: Sequence[SequenceResults],
    metadata: ComparisonMetadata,
    terminal: Terminal,
) -> ComparisonReport:
    """Write everything, the page last. Raises InputError or UserFacingError as `write_file`.

    Args:
        folder: Folder of the report.
        results: Results by recording.
        metadata: Settings of the comparison.
        terminal: Shows the progress.
    """
    figures = {result.recording.name: _draw_figures(folder, result, terminal) for result in results}
    for table in _make_tables(results):
        write_file(folder / f"{table.name}.csv", table.as_csv().encode())
    content = {
        "schema": 1,
        **metadata.as_json(),
        "sequences": [
            {**result.as_json(), "paper": _published_as_json(result)} for result in results
        ],
    }
    write_file(folder / DATA_FILE, (json.dumps(content, indent=2) + "\n").encode())
    write_file(folder / CONFIG_FILE, metadata.config_text.encode())
    write_file(folder / PAGE_FILE, render_page(results, figures, metadata).encode())
    return ComparisonReport(folder / PAGE_FILE, content)


def _make_tables(results: Sequence[SequenceResults]) -> Iterator[Table]:
    yield error_table(results)
    yield time_table(results)
    yield metrics_table(results)
    yield gap_table(results)
    if results[0].has_loop_closure:
        yield loop_closure_table(results)


def _draw_figures(
    folder: Path, result: SequenceResults, terminal: Terminal
) -> list[RenderedFigure]:
    """Write every figure as PNG and SVG, and remove those of an earlier report."""
    figure_folder = folder / "figures"
    create_output_folder(figure_folder)
    for kind in ("frame_error", "global_error", "trajectory"):
        for suffix in ("png", "svg"):
            (figure_folder / f"{result.recording.name}-{kind}.{suffix}").unlink(missing_ok=True)
    figures = []
    for named in _make_figures(result):
        terminal.show(f"{result.recording.name}: drawing {named.name.replace('_', ' ')}")
        path = figure_folder / f"{result.recording.name}-{named.name}"
        write_file(path.with_name(f"{path.name}.png"), render_figure(named, "png"))
        svg = render_figure(named, "svg")
        write_file(path.with_name(f"{path.name}.svg"), svg)
        figures.append(RenderedFigure(path.relative_to(folder).as_posix(), named.caption, svg))
    terminal.clear()
    return figures


def _published_as_json(result: SequenceResults) -> dict[str, dict[str, float]]:
    """Return the paper's results on the same sequence, by method."""
    return {
        method: {"mean_global_error_m": known.mean_global_error_m, "time_s": known.time_s}
        for method, known in find_published_results(result.recording.folder).items()
    }


def _make_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    yield from make_error_figures(result)
    yield from make_trajectory_figures(result)


def render_figure(figure: NamedFigure, file_format: str) -> bytes:
    """Return the file's content. The same figure gives the same bytes."""
    from matplotlib import rc_context

    metadata = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}[file_format]
    data = io.BytesIO()
    with rc_context({"svg.hashsalt": figure.name}):
        figure.figure.savefig(data, format=file_format, dpi=120, metadata=metadata)
    return data.getvalue()

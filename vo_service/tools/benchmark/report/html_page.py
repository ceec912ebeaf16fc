"""Report of a comparison as one HTML page, and its sentences on the results."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from vo_service.tools.benchmark.report.comparison_tables import (
    MIN_FULL_COVERAGE,
    error_table,
    gap_table,
    loop_closure_table,
    metrics_table,
    time_table,
)
from vo_service.tools.benchmark.report.metadata import ComparisonMetadata
from vo_service.tools.benchmark.report.published_results import (
    describe_method,
    find_published_results,
)
from vo_service.tools.benchmark.report.table import Table, number_cell, text_cell
from vo_service.tools.benchmark.results import MIN_RANKED_COVERAGE, RunEvaluation, SequenceResults
from vo_service.tools.benchmark.versions import collect_versions

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

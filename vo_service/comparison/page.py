"""The report as one page of HTML that needs no other file and no network."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from vo_service.comparison import explanations
from vo_service.comparison.findings import describe_rpe_without_gaps, summarize_sequence
from vo_service.comparison.page_parts import (
    html_definitions,
    html_lost_reasons,
    html_paragraph,
    html_run_errors,
    html_table,
)
from vo_service.comparison.page_style import STYLE
from vo_service.comparison.paper import describe_method, find_published_results
from vo_service.comparison.set_up import ComparisonMetadata
from vo_service.comparison.tables import (
    error_table,
    gap_table,
    loop_closure_table,
    metrics_table,
    time_table,
)
from vo_service.runs.results import SequenceResults
from vo_service.runs.versions import collect_versions

TITLE = "Visual odometry methods compared"


@dataclass(frozen=True)
class RenderedFigure:
    """A figure: its file without the suffix, beside the page; its caption; its SVG."""

    path: str
    caption: str
    svg: bytes


def render_page(
    results: Sequence[SequenceResults],
    figures: Mapping[str, Sequence[RenderedFigure]],
    metadata: ComparisonMetadata,
) -> str:
    """The whole page; `drawings` by the recording's name."""
    body = "\n".join(
        [
            *_render_header(results, metadata),
            *_render_overview(results, metadata),
            *(line for k, r in enumerate(results) for line in _render_sequence(r, figures, k)),
            *_render_footer(metadata),
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{TITLE}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
        f"{body}\n</body>\n</html>\n"
    )


def _render_header(
    results: Sequence[SequenceResults], metadata: ComparisonMetadata
) -> Iterator[str]:
    yield f"<h1>{TITLE}</h1>"
    made = f"{metadata.created:%d %B %Y, %H:%M} UTC"
    yield html_paragraph(f"kinect-vo {collect_versions()['kinect-vo']}, {made}", "facts")
    links = [f'<a href="#s{k}">{escape(r.recording.name)}</a>' for k, r in enumerate(results)]
    inner = ['<a href="#tables">Tables</a>', *links, '<a href="#setup">Settings</a>']
    yield f"<nav>{' '.join(inner)}</nav>"
    yield html_paragraph(explanations.INTRODUCTION_TEXT)
    yield html_definitions(
        [
            (describe_method(method).name, describe_method(method).description)
            for method in metadata.methods
        ]
    )


def _render_overview(
    results: Sequence[SequenceResults], metadata: ComparisonMetadata
) -> Iterator[str]:
    yield '<h2 id="tables">Tables</h2>'
    for result in results:
        yield f"<p><b>{escape(result.recording.name)}</b>: {escape(summarize_sequence(result))}</p>"
    yield html_table(error_table(results))
    yield html_paragraph(explanations.ERROR_TEXT, "note")
    if "sfm" in metadata.methods:
        yield html_paragraph(explanations.SFM_SCALE_TEXTS[metadata.sfm_scale], "note")
    yield html_table(time_table(results))
    yield html_paragraph(explanations.TIME_TEXT, "note")
    if results[0].has_loop_closure:
        yield html_table(loop_closure_table(results), hidden=("state", "trouble"))
        yield html_paragraph(explanations.LOOP_CLOSURE_TEXT, "note")
    if any(find_published_results(result.recording.folder) for result in results):
        yield html_paragraph(explanations.PAPER_TEXT, "note")
    yield "<h3>What the figures of each recording mean</h3>"
    yield html_definitions(explanations.METRIC_TEXTS)


def _render_sequence(
    result: SequenceResults, figures: Mapping[str, Sequence[RenderedFigure]], number: int
) -> Iterator[str]:
    yield f'<h2 id="s{number}">{escape(result.recording.name)}</h2>'
    yield html_paragraph(_sequence_facts(result), "facts")
    yield html_table(metrics_table([result]), hidden=("sequence", "trouble"))
    yield from html_run_errors(result)
    for drawing in figures[result.recording.name]:
        yield _render_figure(drawing)
    if result.recording.gaps:
        yield html_table(gap_table([result]), hidden=("sequence",))
        yield html_paragraph(explanations.GAPS_TEXT + describe_rpe_without_gaps(result), "note")
    yield from html_lost_reasons(result)


def _sequence_facts(result: SequenceResults) -> str:
    recording = result.recording
    path = "" if recording.path_m is None else f", a way of {recording.path_m:.1f} m"
    truth = "with ground truth" if recording.truth is not None else "without ground truth"
    pauses = len(recording.gaps)
    paused_s = sum(gap.length_s for gap in recording.gaps)
    count = "one pause" if pauses == 1 else f"{pauses} pauses"
    gaps = f", {count} of {paused_s:.1f} s together" if pauses else ", no pauses"
    frames = len(recording.frame_stamps_s)
    return f"{frames} frames in {recording.duration_s:.1f} s{path}, {truth}{gaps}."


def _render_figure(figure: RenderedFigure) -> str:
    # As an image, not inline: the names inside one SVG must not meet those of another.
    data = base64.b64encode(figure.svg).decode()
    link = quote(figure.path)
    caption = escape(figure.caption)
    alternative = caption.partition(":")[0]
    return (
        f'<figure><div class="wide"><img alt="{alternative}"'
        f' src="data:image/svg+xml;base64,{data}">'
        f'</div><figcaption>{caption} <a href="{link}.png">PNG</a> <a href="{link}.svg">SVG</a>'
        "</figcaption></figure>"
    )


def _render_footer(metadata: ComparisonMetadata) -> Iterator[str]:
    yield '<h2 id="setup">Settings and versions</h2>'
    yield f"<pre>{escape(metadata.config_text)}</pre>"
    lines = "\n".join(f"{name}: {value}" for name, value in collect_versions().items())
    yield f"<pre>{escape(lines)}</pre>"
    yield html_paragraph(
        "Beside this page: the tables as CSV, report.json with every figure, config.toml, the "
        "figures as PNG and SVG, and in runs/ the trajectory and the frames of every run.",
        "note",
    )

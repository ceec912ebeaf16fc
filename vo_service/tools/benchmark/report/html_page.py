"""Report as one HTML page that needs no other file and no network."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from vo_service.tools.benchmark.report import help_texts
from vo_service.tools.benchmark.report.comparison_tables import (
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
from vo_service.tools.benchmark.report.summary_text import (
    describe_rpe_without_gaps,
    summarize_sequence,
)
from vo_service.tools.benchmark.report.table import Table, TableCell, text_cell
from vo_service.tools.benchmark.results import SequenceResults
from vo_service.tools.benchmark.versions import collect_versions

TITLE = "Visual odometry methods compared"


@dataclass(frozen=True)
class RenderedFigure:
    """Figure: its path relative to the page without suffix, its caption and its SVG."""

    path: str
    caption: str
    svg: bytes


def render_page(
    results: Sequence[SequenceResults],
    figures: Mapping[str, Sequence[RenderedFigure]],
    metadata: ComparisonMetadata,
) -> str:
    """Return the whole page; `figures` is keyed by the recording's name."""
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
    created = f"{metadata.created:%d %B %Y, %H:%M} UTC"
    yield html_paragraph(f"kinect-vo {collect_versions()['kinect-vo']}, {created}", "facts")
    links = [f'<a href="#s{k}">{escape(r.recording.name)}</a>' for k, r in enumerate(results)]
    inner = ['<a href="#tables">Tables</a>', *links, '<a href="#setup">Settings</a>']
    yield f"<nav>{' '.join(inner)}</nav>"
    yield html_paragraph(help_texts.INTRODUCTION_TEXT)
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
    yield html_paragraph(help_texts.ERROR_TEXT, "note")
    if "sfm" in metadata.methods:
        yield html_paragraph(help_texts.SFM_SCALE_TEXTS[metadata.sfm_scale], "note")
    yield html_table(time_table(results))
    yield html_paragraph(help_texts.TIME_TEXT, "note")
    if results[0].has_loop_closure:
        yield html_table(loop_closure_table(results), hidden=("state", "error"))
        yield html_paragraph(help_texts.LOOP_CLOSURE_TEXT, "note")
    if any(find_published_results(result.recording.folder) for result in results):
        yield html_paragraph(help_texts.PAPER_TEXT, "note")
    yield "<h3>Meaning of the metrics</h3>"
    yield html_definitions(help_texts.METRIC_TEXTS)


def _render_sequence(
    result: SequenceResults, figures: Mapping[str, Sequence[RenderedFigure]], number: int
) -> Iterator[str]:
    yield f'<h2 id="s{number}">{escape(result.recording.name)}</h2>'
    yield html_paragraph(_sequence_facts(result), "facts")
    yield html_table(metrics_table([result]), hidden=("sequence", "error"))
    yield from html_run_errors(result)
    for figure in figures[result.recording.name]:
        yield _render_figure(figure)
    if result.recording.gaps:
        yield html_table(gap_table([result]), hidden=("sequence",))
        yield html_paragraph(help_texts.GAPS_TEXT + describe_rpe_without_gaps(result), "note")
    yield from html_lost_reasons(result)


def _sequence_facts(result: SequenceResults) -> str:
    recording = result.recording
    path = "" if recording.path_m is None else f", a path of {recording.path_m:.1f} m"
    truth = "with ground truth" if recording.truth is not None else "without ground truth"
    pauses = len(recording.gaps)
    paused_s = sum(gap.length_s for gap in recording.gaps)
    count = "one pause" if pauses == 1 else f"{pauses} pauses"
    gaps = f", {count} of {paused_s:.1f} s in total" if pauses else ", no pauses"
    frames = len(recording.frame_stamps_s)
    return f"{frames} frames in {recording.duration_s:.1f} s{path}, {truth}{gaps}."


def _render_figure(figure: RenderedFigure) -> str:
    # As an image, not inline, because names in different SVGs could collide.
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
        "Beside this page: the tables as CSV, report.json with all metrics, config.toml, the "
        "figures as PNG and SVG, and in runs/ the trajectory and the frames of every run.",
        "note",
    )


def html_paragraph(text: str, css_class: str = "") -> str:
    """Return a paragraph of plain text with an optional CSS class."""
    return f"<p{_class_attribute(css_class)}>{escape(text)}</p>"


def html_definitions(entries: Sequence[tuple[str, str]]) -> str:
    """Return a list of terms and their definitions."""
    items = "".join(f"<dt>{escape(word)}</dt><dd>{escape(text)}</dd>" for word, text in entries)
    return f"<dl>{items}</dl>"


def html_table(table: Table, hidden: Sequence[str] = ()) -> str:
    """Return a table, without the `hidden` columns, that scrolls if it is too wide."""
    visible = [k for k, key in enumerate(table.keys) if key not in hidden]
    kinds = [_class_attribute(_cell_class([row[k] for row in table.rows])) for k in visible]
    titles = [escape(table.headings[k]) for k in visible]
    head = "".join(
        f'<th scope="col"{kind}>{title}</th>' for kind, title in zip(kinds, titles, strict=True)
    )
    rows = "".join(f"<tr>{''.join(_html_cell(row[k]) for k in visible)}</tr>" for row in table.rows)
    return (
        f'<div class="wide"><table><caption>{escape(table.title)}</caption>'
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>"
    )


def html_run_errors(result: SequenceResults) -> Iterator[str]:
    """Yield the errors of a recording's runs."""
    for method, evaluation in result.evaluations.items():
        name = describe_method(method).name
        if not evaluation.is_done:
            yield html_paragraph(f"{name}: {evaluation.outcome}", "bad")
        elif evaluation.no_evaluation_reason and result.recording.truth is not None:
            yield html_paragraph(
                f"{name} is not evaluated: {evaluation.no_evaluation_reason}", "bad"
            )
        if evaluation.outcome.details:
            details = escape(evaluation.outcome.details)
            yield f"<details><summary>Traceback</summary><pre>{details}</pre></details>"


def html_lost_reasons(result: SequenceResults) -> Iterator[str]:
    """Yield the reasons for lost frames, the most frequent first."""
    rows = [
        [
            text_cell(method, describe_method(method).name),
            text_cell(reason),
            TableCell(count, str(count)),
        ]
        for method, evaluation in result.evaluations.items()
        for reason, count in evaluation.lost_reasons
    ]
    if rows:
        head = ["method", "why", "frames"]
        yield html_table(Table("", "Lost frames", head, head, rows))
        yield html_paragraph(help_texts.LOST_FRAMES_TEXT, "note")


def _html_cell(cell: TableCell) -> str:
    kind = " ".join(filter(None, [_cell_class([cell]), "best" if cell.is_best else ""]))
    return f"<td{_class_attribute(kind)}>{escape(cell.text)}</td>"


def _cell_class(cells: Sequence[TableCell]) -> str:
    """Return the CSS class of a column; texts are left-aligned."""
    return "text" if any(isinstance(cell.value, str) for cell in cells) else ""


def _class_attribute(css_class: str) -> str:
    return f' class="{css_class}"' if css_class else ""


STYLE = """\
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem; max-width: 70rem; background: #fff; color: #1c2126;
  font: 1rem/1.55 system-ui, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 1rem 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .4rem; padding-top: .6rem; border-top: 1px solid #d5dade; }
h3 { font-size: 1.05rem; margin: 1.6rem 0 .3rem; }
p, dd, figcaption { max-width: 46rem; }
p { margin: .4rem 0 .8rem; }
nav a { margin-right: 1rem; white-space: nowrap; }
a { color: #0b5cad; }
.facts, figcaption, .note { color: #4c565f; font-size: .92rem; }
.wide { overflow-x: auto; margin: .6rem 0 1rem; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding-bottom: .3rem; }
th, td { padding: .3rem .6rem; border-bottom: 1px solid #e3e7ea; text-align: right; }
td { white-space: nowrap; }
th { vertical-align: bottom; font-weight: 600; background: #f4f6f8; }
th:first-child, td:first-child, .text { text-align: left; }
.best { font-weight: 700; }
.bad { color: #a3280c; }
figure { margin: 1.2rem 0 1.8rem; }
figure img { display: block; width: 100%; min-width: 40rem; height: auto;
  border: 1px solid #e3e7ea; }
figure .wide { margin: 0; }
figcaption { margin-top: .4rem; }
dt { font-weight: 600; margin-top: .6rem; }
dd { margin: 0; }
pre { overflow-x: auto; background: #f4f6f8; padding: .8rem; font-size: .85rem; }
@media print { body { max-width: none; } nav { display: none; }
  figure, tr { break-inside: avoid; } }
"""

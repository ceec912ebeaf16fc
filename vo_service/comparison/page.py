"""The report as one page of HTML that needs no other file and no network."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from vo_service.comparison import explanations
from vo_service.comparison.findings import finding, without_pauses
from vo_service.comparison.page_parts import (
    definitions,
    html_table,
    paragraph,
    troubles,
    why_lost,
)
from vo_service.comparison.page_style import STYLE
from vo_service.comparison.paper import about, paper_figures
from vo_service.comparison.set_up import SetUp
from vo_service.comparison.tables import (
    error_table,
    gap_table,
    loops_table,
    metrics_table,
    time_table,
)
from vo_service.runs.results import SequenceResults
from vo_service.runs.versions import versions

TITLE = "Visual odometry methods compared"


@dataclass(frozen=True)
class Drawing:
    """A figure: its file without the suffix, beside the page; its caption; its SVG."""

    path: str
    caption: str
    svg: bytes


def page(
    results: Sequence[SequenceResults], drawings: Mapping[str, Sequence[Drawing]], set_up: SetUp
) -> str:
    """The whole page; `drawings` by the recording's name."""
    body = "\n".join(
        [
            *_beginning(results, set_up),
            *_overview(results, set_up),
            *(line for k, r in enumerate(results) for line in _sequence(r, drawings, k)),
            *_end(set_up),
        ]
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{TITLE}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
        f"{body}\n</body>\n</html>\n"
    )


def _beginning(results: Sequence[SequenceResults], set_up: SetUp) -> Iterator[str]:
    yield f"<h1>{TITLE}</h1>"
    made = f"{set_up.created:%d %B %Y, %H:%M} UTC"
    yield paragraph(f"kinect-vo {versions()['kinect-vo']}, {made}", "facts")
    links = [f'<a href="#s{k}">{escape(r.recording.name)}</a>' for k, r in enumerate(results)]
    inner = ['<a href="#tables">Tables</a>', *links, '<a href="#setup">Settings</a>']
    yield f"<nav>{' '.join(inner)}</nav>"
    yield paragraph(explanations.INTRODUCTION)
    yield definitions([(about(method).name, about(method).text) for method in set_up.methods])


def _overview(results: Sequence[SequenceResults], set_up: SetUp) -> Iterator[str]:
    yield '<h2 id="tables">Tables</h2>'
    for result in results:
        yield f"<p><b>{escape(result.recording.name)}</b>: {escape(finding(result))}</p>"
    yield html_table(error_table(results))
    yield paragraph(explanations.ERROR, "note")
    if "sfm" in set_up.methods:
        yield paragraph(explanations.SFM_SCALE[set_up.sfm_scale], "note")
    yield html_table(time_table(results))
    yield paragraph(explanations.TIME, "note")
    if results[0].has_loops:
        yield html_table(loops_table(results), hidden=("state", "trouble"))
        yield paragraph(explanations.LOOPS, "note")
    if any(paper_figures(result.recording.folder) for result in results):
        yield paragraph(explanations.PAPER, "note")
    yield "<h3>What the figures of each recording mean</h3>"
    yield definitions(explanations.METRICS)


def _sequence(
    result: SequenceResults, drawings: Mapping[str, Sequence[Drawing]], number: int
) -> Iterator[str]:
    yield f'<h2 id="s{number}">{escape(result.recording.name)}</h2>'
    yield paragraph(_facts(result), "facts")
    yield html_table(metrics_table([result]), hidden=("sequence", "trouble"))
    yield from troubles(result)
    for drawing in drawings[result.recording.name]:
        yield _figure(drawing)
    if result.recording.gaps:
        yield html_table(gap_table([result]), hidden=("sequence",))
        yield paragraph(explanations.PAUSES + without_pauses(result), "note")
    yield from why_lost(result)


def _facts(result: SequenceResults) -> str:
    recording = result.recording
    path = "" if recording.path_m is None else f", a way of {recording.path_m:.1f} m"
    truth = "with ground truth" if recording.truth is not None else "without ground truth"
    pauses = len(recording.gaps)
    paused_s = sum(gap.length_s for gap in recording.gaps)
    count = "one pause" if pauses == 1 else f"{pauses} pauses"
    gaps = f", {count} of {paused_s:.1f} s together" if pauses else ", no pauses"
    frames = len(recording.frames_s)
    return f"{frames} frames in {recording.duration_s:.1f} s{path}, {truth}{gaps}."


def _figure(drawing: Drawing) -> str:
    # As an image, not inline: the names inside one SVG must not meet those of another.
    data = base64.b64encode(drawing.svg).decode()
    link = quote(drawing.path)
    caption = escape(drawing.caption)
    alternative = caption.partition(":")[0]
    return (
        f'<figure><div class="wide"><img alt="{alternative}"'
        f' src="data:image/svg+xml;base64,{data}">'
        f'</div><figcaption>{caption} <a href="{link}.png">PNG</a> <a href="{link}.svg">SVG</a>'
        "</figcaption></figure>"
    )


def _end(set_up: SetUp) -> Iterator[str]:
    yield '<h2 id="setup">Settings and versions</h2>'
    yield f"<pre>{escape(set_up.config_text)}</pre>"
    lines = "\n".join(f"{name}: {value}" for name, value in versions().items())
    yield f"<pre>{escape(lines)}</pre>"
    yield paragraph(
        "Beside this page: the tables as CSV, report.json with every figure, config.toml, the "
        "figures as PNG and SVG, and in runs/ the trajectory and the frames of every run.",
        "note",
    )

"""The report's folder: the page, and every table and figure of it as a file of its own."""

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vo_service.comparison.figures import NamedFigure, error_figures
from vo_service.comparison.page import Drawing, page
from vo_service.comparison.paper import paper_figures
from vo_service.comparison.path_figure import path_figures
from vo_service.comparison.set_up import SetUp
from vo_service.comparison.tables import (
    error_table,
    gap_table,
    loops_table,
    metrics_table,
    time_table,
)
from vo_service.folders import make_output_folder
from vo_service.runs.keeping import write_file
from vo_service.runs.results import SequenceResults
from vo_service.runs.table import Table
from vo_service.terminal import Terminal

PAGE, DATA, CONFIG = "report.html", "report.json", "config.toml"


@dataclass(frozen=True)
class Report:
    """Where the report is, and all its figures as one object."""

    page: Path
    content: dict[str, Any]


def write_report(
    folder: Path, results: Sequence[SequenceResults], set_up: SetUp, terminal: Terminal
) -> Report:
    """Write everything, the page last. Raises InputError or UserFacingError as `write_file`."""
    drawings = {result.recording.name: _draw(folder, result, terminal) for result in results}
    for table in _tables(results):
        write_file(folder / f"{table.name}.csv", table.as_csv().encode())
    content = {
        "schema": 1,
        **set_up.as_json(),
        "sequences": [{**result.as_json(), "paper": _paper(result)} for result in results],
    }
    write_file(folder / DATA, (json.dumps(content, indent=2) + "\n").encode())
    write_file(folder / CONFIG, set_up.config_text.encode())
    write_file(folder / PAGE, page(results, drawings, set_up).encode())
    return Report(folder / PAGE, content)


def _tables(results: Sequence[SequenceResults]) -> Iterator[Table]:
    yield error_table(results)
    yield time_table(results)
    yield metrics_table(results)
    yield gap_table(results)
    if results[0].has_loops:
        yield loops_table(results)


def _draw(folder: Path, result: SequenceResults, terminal: Terminal) -> list[Drawing]:
    """Every figure as PNG and SVG; those of an earlier report that have no successor go."""
    figures = folder / "figures"
    make_output_folder(figures)
    for kind in ("frame_error", "global_error", "trajectory"):
        for suffix in ("png", "svg"):
            (figures / f"{result.recording.name}-{kind}.{suffix}").unlink(missing_ok=True)
    drawings = []
    for named in _figures(result):
        terminal.show(f"{result.recording.name}: drawing {named.name.replace('_', ' ')}")
        path = figures / f"{result.recording.name}-{named.name}"
        write_file(path.with_name(f"{path.name}.png"), image(named, "png"))
        svg = image(named, "svg")
        write_file(path.with_name(f"{path.name}.svg"), svg)
        drawings.append(Drawing(path.relative_to(folder).as_posix(), named.caption, svg))
    terminal.clear()
    return drawings


def _paper(result: SequenceResults) -> dict[str, dict[str, float]]:
    """What the paper reports of the same sequence, by method."""
    return {
        method: {"mean_global_error_m": known.mean_global_error_m, "time_s": known.time_s}
        for method, known in paper_figures(result.recording.folder).items()
    }


def _figures(result: SequenceResults) -> Iterator[NamedFigure]:
    yield from error_figures(result)
    yield from path_figures(result)


def image(named: NamedFigure, kind: str) -> bytes:
    """The file's content. The same figure gives the same bytes."""
    from matplotlib import rc_context

    metadata = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}[kind]
    data = io.BytesIO()
    with rc_context({"svg.hashsalt": named.name}):
        named.figure.savefig(data, format=kind, dpi=120, metadata=metadata)
    return data.getvalue()

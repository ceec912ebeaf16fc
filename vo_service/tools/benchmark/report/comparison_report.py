"""Report folder: the page, and each table and figure as a separate file."""

import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.core.files import create_output_folder
from vo_service.terminal import Terminal
from vo_service.tools.benchmark.report.comparison_tables import (
    error_table,
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
from vo_service.tools.benchmark.report.html_page import RenderedFigure, render_page
from vo_service.tools.benchmark.report.metadata import ComparisonMetadata
from vo_service.tools.benchmark.report.published_results import find_published_results
from vo_service.tools.benchmark.report.table import Table
from vo_service.tools.benchmark.results import SequenceResults
from vo_service.tools.benchmark.run_cache import write_file

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

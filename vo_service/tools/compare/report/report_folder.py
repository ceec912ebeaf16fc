"""Report folder of a comparison: the page, the data, and each table and figure as a file."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from drivers.core.files import atomic_write
from drivers.core.write_errors import create_output_folder
from vo_service.terminal import Terminal
from vo_service.tools.compare.report.figures import make_figures
from vo_service.tools.compare.report.metadata import ReportMetadata
from vo_service.tools.compare.report.metrics import metrics_as_json
from vo_service.tools.compare.report.page import RenderedFigure, render_page
from vo_service.tools.compare.report.tables import (
    find_published_results,
    gap_table,
    metrics_table,
    paper_table,
)
from vo_service.tools.compare.results import SequenceResults

PAGE_FILE, DATA_FILE, CONFIG_FILE = "report.html", "report.json", "config.toml"


def write_report(
    folder: Path, metadata: ReportMetadata, results: Sequence[SequenceResults], terminal: Terminal
) -> None:
    """Write everything, the page last. Raises UserFacingError."""
    figures = {result.recording.name: _draw_figures(folder, result, terminal) for result in results}
    tables = {"metrics": metrics_table(results), "gaps": gap_table(results)}
    for name, table in {**tables, "paper": paper_table(results)}.items():
        file = folder / f"{name}.csv"
        if table.rows:
            atomic_write(file, _encode(table.as_csv()))
        else:  # there may be one of an earlier report
            file.unlink(missing_ok=True)
    content = json.dumps(report_content(metadata, results), indent=2)
    atomic_write(folder / DATA_FILE, f"{content}\n".encode())
    atomic_write(folder / CONFIG_FILE, _encode(metadata.config_text))
    atomic_write(folder / PAGE_FILE, _encode(render_page(metadata, results, figures)))


def _encode(text: str) -> bytes:
    """Encode a text as UTF-8; bytes of a folder's name that are none are escaped."""
    return text.encode(errors="backslashreplace")


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
    for named in make_figures(result):
        terminal.show(f"{result.recording.name}: drawing {named.name.replace('_', ' ')}")
        path = figure_folder / f"{result.recording.name}-{named.name}"
        atomic_write(path.with_name(f"{path.name}.png"), named.render("png"))
        svg = named.render("svg")
        atomic_write(path.with_name(f"{path.name}.svg"), svg)
        figures.append(RenderedFigure(path.relative_to(folder).as_posix(), named.caption, svg))
    terminal.clear()
    return figures


def report_content(metadata: ReportMetadata, results: Sequence[SequenceResults]) -> dict[str, Any]:
    """Return the whole content of report.json."""
    sequences = [_sequence_as_json(result) for result in results]
    return {"schema": 1, **metadata.as_json(), "sequences": sequences}


def _sequence_as_json(result: SequenceResults) -> dict[str, Any]:
    """Return the facts of the recording, the metrics of each method, and the paper's results."""
    recording = result.recording
    return {
        "name": recording.folder_name,
        "folder": str(recording.folder.resolve()),
        "every": recording.frame_selection.step,
        "frames": len(recording.frame_stamps_s),
        "duration_s": recording.duration_s,
        "path_m": recording.path_m,
        "has_ground_truth": recording.truth is not None,
        "gaps": [
            {"begin_s": gap.begin_s, "end_s": gap.end_s, "length_s": gap.length_s}
            for gap in recording.gaps
        ],
        "methods": {
            method: {**evaluation.as_json(), **metrics_as_json(result, method)}
            for method, evaluation in result.evaluations.items()
        },
        "paper": {
            method: known._asdict() for method, known in find_published_results(recording).items()
        },
    }

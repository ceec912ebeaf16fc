"""Report folder of a comparison: the HTML page, the data, and each table and figure as a file."""

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from drivers.core.files import atomic_write
from drivers.core.write_errors import create_output_folder
from vo_service.terminal import Terminal
from vo_service.tools.benchmark.report.figures import make_figures
from vo_service.tools.benchmark.report.metadata import ReportMetadata
from vo_service.tools.benchmark.report.metrics import GLOBAL_ERROR, metrics_as_json
from vo_service.tools.benchmark.report.tables import (
    cost_table,
    error_table,
    find_published_results,
    gap_table,
    lost_frames_table,
    metrics_table,
    paper_table,
)
from vo_service.tools.benchmark.results import SequenceResults

PAGE_FILE, DATA_FILE, CONFIG_FILE = "report.html", "report.json", "config.toml"
# A lower coverage is named in the summary.
MIN_FULL_COVERAGE = 0.99
METHOD_DESCRIPTIONS = {
    "surf": "color and depth: SURF features of a frame are matched with those of the previous "
    "frame. RANSAC selects the matches that agree on one motion, and singular value decomposition "
    "fits it. This is the method that the paper of Fontes and Maia proposes.",
    "icp": "depth only: the surface in a frame is aligned with that of an earlier frame (iterative "
    "closest point). It needs structure: if it sees hardly more than one plane, it gives no pose.",
    "sfm": "color only: features are tracked from frame to frame, and give motion and points "
    "together (structure from motion). Color alone has no scale: the first scale is given, and it "
    "may drift from there.",
    "direct": "color and depth: brightness and depth of every frame are aligned with those of a "
    "keyframe, which stays as long as most of it is in view; each sensor row has its own time. "
    "This is the default of the service.",
    "cv2-rgb": "cv2.Odometry of OpenCV: the brightness of two frames is aligned.",
    "cv2-rgb-depth": "cv2.Odometry of OpenCV: brightness and depth of two frames are aligned.",
    "cv2-depth": "cv2.Odometry of OpenCV: the depth of two frames is aligned (ICP).",
    "open3d-icp": "Open3D's point-to-plane ICP, on depth only.",
    "open3d-hybrid": "Open3D's RGB-D odometry: brightness and depth of two frames are aligned.",
    "small-gicp": "generalized ICP of small_gicp, on depth only.",
    "sift": "as surf, with OpenCV's SIFT features.",
    "orb": "as surf, with OpenCV's ORB features.",
    "orb-slam3": "ORB-SLAM3 in its RGB-D mode; each pose as its tracking returns it.",
}


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


def write_report(
    folder: Path, metadata: ReportMetadata, results: Sequence[SequenceResults], terminal: Terminal
) -> None:
    """Write everything, the page last. Raises UserFacingError.

    Args:
        folder: Folder of the report.
        metadata: Settings of the comparison.
        results: Results by recording and frame step.
        terminal: Shows the progress.
    """
    figures = {result.recording.name: _draw_figures(folder, result, terminal) for result in results}
    tables = {"metrics": metrics_table(results), "gaps": gap_table(results)}
    for name, table in {**tables, "paper": paper_table(results)}.items():
        file = folder / f"{name}.csv"
        if table.rows:
            atomic_write(file, table.as_csv().encode())
        else:  # there may be one of an earlier report
            file.unlink(missing_ok=True)
    content = json.dumps(report_content(metadata, results), indent=2)
    atomic_write(folder / DATA_FILE, f"{content}\n".encode())
    atomic_write(folder / CONFIG_FILE, metadata.config_text.encode())
    atomic_write(folder / PAGE_FILE, render_page(metadata, results, figures).encode())


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
    """Return the whole content of report.json.

    Args:
        metadata: Settings of the comparison.
        results: Results by recording and frame step.
    """
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


def render_page(
    metadata: ReportMetadata,
    results: Sequence[SequenceResults],
    figures: Mapping[str, Sequence[RenderedFigure]],
) -> str:
    """Return the page, which needs no other file and no network.

    Args:
        metadata: Settings of the comparison.
        results: Results by recording and frame step.
        figures: Figures by the recording's name.
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
        *(describe_recording, describe_rpe_without_gaps, summarize_sequence),
        *(error_table, cost_table, gap_table, lost_frames_table, paper_table),
    )
    environment.globals.update({function.__name__: function for function in functions})
    return environment.get_template(PAGE_FILE).render(
        metadata=metadata,
        results=results,
        figures=figures,
        descriptions={
            method: METHOD_DESCRIPTIONS.get(method, "a plug-in.") for method in metadata.methods
        },
    )


def describe_recording(result: SequenceResults) -> str:
    """Return a sentence on the recording: path, truth and pauses."""
    recording = result.recording
    path = "" if recording.path_m is None else f"a path of {recording.path_m:.1f} m, "
    truth = "with ground truth" if recording.truth is not None else "without ground truth"
    pauses = len(recording.gaps)
    paused_s = sum(gap.length_s for gap in recording.gaps)
    count = "one pause" if pauses == 1 else f"{pauses} pauses"
    gaps = f"{count} of {paused_s:.1f} s in total" if pauses else "no pauses"
    return f"{path}{truth}, {gaps}.".capitalize()


def describe_rpe_without_gaps(result: SequenceResults) -> str:
    """Return a sentence on the RPE without pauses; "" if not known."""
    known = [
        f"{1e3 * evaluation.rpe_frame_without_gaps_m:.1f} mm for {method}"
        for method, evaluation in result.evaluations.items()
        if evaluation.rpe_frame_without_gaps_m is not None
    ]
    return f" Without the pauses, the RPE of one frame is {', '.join(known)}." if known else ""


def summarize_sequence(result: SequenceResults) -> str:
    """Return sentences on the best method, low coverage and failed runs."""
    return " ".join(_summary_sentences(result))


def _summary_sentences(result: SequenceResults) -> Iterator[str]:
    best = result.best_method(GLOBAL_ERROR.value)
    if result.recording.truth is None:
        yield "without ground truth, errors are not known."
    elif best is not None:
        error_m = GLOBAL_ERROR.value(result.evaluations[best]) or 0.0
        yield f"{best} has the smallest mean global error, {1e3 * error_m:.2f} mm."
    for method, evaluation in result.evaluations.items():
        if not evaluation.is_done:
            yield f"{method} has no result ({evaluation.outcome.state})."
        elif evaluation.coverage is not None and evaluation.coverage < MIN_FULL_COVERAGE:
            yield f"{method} has poses for only {100 * evaluation.coverage:.0f} % of the frames."

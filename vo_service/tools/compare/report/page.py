"""The HTML page of a comparison: needs no other file and no network."""

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vo_service.tools.compare.report.metadata import ReportMetadata
from vo_service.tools.compare.report.metrics import GLOBAL_ERROR
from vo_service.tools.compare.report.tables import (
    cost_table,
    error_table,
    gap_table,
    lost_frames_table,
    paper_table,
)
from vo_service.tools.compare.results import SequenceResults

TEMPLATE_FILE = "report.html"
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
    def data_url(self) -> str:
        """URL of the SVG itself: as an image, because names in different SVGs could collide."""
        return f"data:image/svg+xml;base64,{base64.b64encode(self.svg).decode()}"


def render_page(
    metadata: ReportMetadata,
    results: Sequence[SequenceResults],
    figures: Mapping[str, Sequence[RenderedFigure]],
) -> str:
    """Return the page; `figures` are by the recording's name."""
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
    return environment.get_template(TEMPLATE_FILE).render(
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

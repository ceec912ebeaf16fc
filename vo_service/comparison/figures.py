"""The figures of one recording: the paper's Figures 6 to 9 and 10, all methods in one plot.

Drawn without pyplot: no global state, no window.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.geometry import Array
from drivers.trajectory import nearest
from vo_service.comparison.paper import about
from vo_service.evaluation.picture import broken_at_gaps, label_axes
from vo_service.evaluation.series import ErrorSeries, error_series
from vo_service.runs.results import SequenceResults

if TYPE_CHECKING:  # drawn with rarely, and slow to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Told apart by people who see colours differently too (Okabe and Ito).
COLOURS = {"surf": "#0072B2", "icp": "#D55E00", "sfm": "#009E73", "keyframe": "#CC79A7"}
OTHER_COLOURS = ("#56B4E9", "#E69F00", "#000000")
# Frames that a thick line's median is taken over.
SMOOTHED = 15
# Where the methods differ by more than this, a linear axis would hide the better ones.
LOG_FROM = 20.0
PAUSE: dict[str, Any] = {"color": "0.45", "linestyle": (0, (4, 3)), "linewidth": 1.0}


@dataclass(frozen=True)
class NamedFigure:
    """A figure with the end of its file's name, and what a stranger must know of it."""

    name: str
    caption: str
    figure: "Figure"


def colour_of(method: str, methods: list[str]) -> str:
    """The same in every figure and report for the methods that are known."""
    others = [other for other in methods if other not in COLOURS]
    return COLOURS.get(method) or OTHER_COLOURS[others.index(method) % len(OTHER_COLOURS)]


def error_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    """Error frame by frame, and global error; none where no method could be judged."""
    series = {
        method: error_series(judged.matched)
        for method, judged in result.judged.items()
        if judged.matched is not None
    }
    if series:
        yield NamedFigure("frame_error", _FRAME_CAPTION, _draw_steps(result, series))
        yield NamedFigure("global_error", _GLOBAL_CAPTION, _draw_global(result, series))


_FRAME_CAPTION = (
    "Error frame by frame (as the paper's Figures 6 to 9): how wrong the motion from each frame to "
    "the next is, in millimetres and in degrees. Low is good; a peak is one bad step. Thin lines "
    f"are the frames themselves, thick ones the median of {SMOOTHED} of them. The scale is "
    "logarithmic. Marks at the bottom, if any, are frames that a method could not place."
)
_GLOBAL_CAPTION = (
    "Global error (as the paper's Figures 6 to 9): how far the estimated camera is from the true "
    "one, with both trajectories joined at the first frame. Errors of single steps add up, "
    "so the lines drift; their mean is the mean global error of Table I. Marks at the bottom, if "
    "any, are frames that a method could not place."
)


def _draw_steps(result: SequenceResults, series: Mapping[str, ErrorSeries]) -> "Figure":
    figure = new_figure(10, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    label_axes(above, "", "", "error of a step (mm)")
    label_axes(below, "", "frame", "error of a step (degrees)")
    for method, errors in series.items():
        colour = colour_of(method, list(result.judged))
        _draw_noisy(above, result, errors.stamps_s[1:], 1e3 * errors.steps.translation_m, colour)
        _draw_noisy(below, result, errors.stamps_s[1:], errors.steps.rotation_deg, colour)
    for plot in (above, below):
        _make_logarithmic(plot)
        _draw_lost(plot, result)
        _draw_pauses(plot, result)
    _legend(figure, result, list(series))
    return figure


def _draw_global(result: SequenceResults, series: Mapping[str, ErrorSeries]) -> "Figure":
    figure = new_figure(10, 4.5)
    plot = figure.subplots()
    largest = [float(errors.global_m.max()) for errors in series.values()]
    is_log = max(largest) > LOG_FROM * min(largest) > 0
    label_axes(plot, "", "frame", "distance from the truth (m)" + ", logarithmic" * is_log)
    for method, errors in series.items():
        frames = _frame_numbers(result, errors.stamps_s)
        values = np.column_stack(
            [frames, _positive(errors.global_m) if is_log else errors.global_m]
        )
        line = broken_at_gaps(errors.stamps_s, values)
        plot.plot(*line.T, color=colour_of(method, list(result.judged)), linewidth=1.5)
    if is_log:
        _make_logarithmic(plot)
    else:
        plot.set_ylim(bottom=0)
    _draw_lost(plot, result)
    _draw_pauses(plot, result)
    _legend(figure, result, list(series))
    return figure


def new_figure(width: float, height: float) -> "Figure":
    """A figure that can be saved, of so many inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _draw_noisy(
    plot: "Axes", result: SequenceResults, stamps_s: Array, values: Array, colour: str
) -> None:
    """The values thin, their median thick; no line is drawn where frames are lost."""
    frames = _frame_numbers(result, stamps_s)
    line = broken_at_gaps(stamps_s, np.column_stack([frames, _positive(values)]))
    plot.plot(*line.T, color=colour, linewidth=0.5, alpha=0.35)
    if len(values) >= SMOOTHED:
        windows = np.lib.stride_tricks.sliding_window_view(values, SMOOTHED)
        middle = slice(SMOOTHED // 2, SMOOTHED // 2 + len(windows))
        smooth = np.column_stack([frames[middle], _positive(np.median(windows, axis=1))])
        plot.plot(*broken_at_gaps(stamps_s[middle], smooth).T, color=colour, linewidth=1.8)


def _make_logarithmic(plot: "Axes") -> None:
    """With plain numbers at its ticks; left as it is where nothing is more than 0."""
    if not np.isfinite(plot.dataLim.minposy):
        return
    plot.set_yscale("log")
    plot.yaxis.set_major_formatter(lambda value, position: f"{value:g}")


def _positive(values: Array) -> Array:
    """Without what a logarithmic axis cannot show."""
    return np.where(values > 0, values, np.nan)


def _draw_lost(plot: "Axes", result: SequenceResults) -> None:
    """A row of marks a method, at the foot of the plot."""
    for row, (method, judged) in enumerate(result.judged.items()):
        log = judged.outcome.run.frames
        frames = _frame_numbers(result, log.stamps_s[~log.is_good])
        heights = np.full(len(frames), 0.015 + 0.03 * row)
        plot.plot(
            frames, heights, "|", color=colour_of(method, list(result.judged)), markersize=5,
            transform=plot.get_xaxis_transform(), clip_on=True, zorder=3,
        )  # fmt: skip


def _draw_pauses(plot: "Axes", result: SequenceResults) -> None:
    for gap in result.recording.gaps:
        plot.axvline(float(_frame_numbers(result, np.array([gap.end_s]))[0]) - 0.5, **PAUSE)
    plot.set_xlim(-0.5, len(result.recording.frames_s) - 0.5)


def _frame_numbers(result: SequenceResults, stamps_s: Array) -> Array:
    """Which of the recording's frames these are, from 0."""
    return nearest(result.recording.frames_s, stamps_s).astype(np.float64)


def _legend(figure: "Figure", result: SequenceResults, methods: list[str]) -> None:
    """Above the plots; also of what only some recordings have."""
    from matplotlib.lines import Line2D

    all_methods = list(result.judged)
    handles = [
        Line2D([], [], color=colour_of(method, all_methods), linewidth=2, label=about(method).name)
        for method in methods
    ]
    if any(judged.outcome.run.failed for judged in result.judged.values()):
        handles.append(Line2D([], [], color="0.3", marker="|", linestyle="", label="frame lost"))
    if result.recording.gaps:
        handles.append(Line2D([], [], **PAUSE, label="pause in the recording"))
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)

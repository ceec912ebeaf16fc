"""Figures of one recording with all methods, like the paper's Figures 6 to 10."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.core.geometry import Array, Trajectory, inverse, nearest_indices
from vo_service.figures import new_figure, render_figure
from vo_service.tools.compare.results import SequenceResults
from vo_service.tools.evaluation.metrics import (
    MatchedPoses,
    consecutive_pairs,
    first_pose_alignment,
    position_errors_m,
    relative_errors,
)
from vo_service.tools.evaluation.plot import (
    GROUND_TRUTH_STYLE,
    crop_trajectory,
    draw_trajectory,
    insert_nan_at_gaps,
    label_axes,
)

if TYPE_CHECKING:  # rarely used, and slow to import
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Colors for color-blind readers, too (Okabe and Ito). Other methods have dashed lines.
METHOD_COLORS = {"surf": "#0072B2", "icp": "#D55E00", "sfm": "#009E73", "direct": "#CC79A7"}
OTHER_METHOD_COLORS = ("#56B4E9", "#E69F00", "#000000")
OTHER_LINE_STYLES = ("--", ":", "-.")
MAX_LEGEND_COLUMNS = 6
# A thick line is the median of this many frames.
SMOOTHING_FRAMES = 15
# If the methods differ by more than this, a linear axis would hide the better ones.
MAX_LINEAR_RATIO = 20.0
THIN_STYLE: dict[str, Any] = {"linestyle": "-", "linewidth": 0.5, "alpha": 0.35}
THICK_STYLE: dict[str, Any] = {"linewidth": 1.8}
GAP_STYLE: dict[str, Any] = {"color": "0.45", "linestyle": (0, (4, 3)), "linewidth": 1.0}
# The figure shows at most this many times the extent of the truth. Otherwise one diverging method
# would shrink all others to a dot.
MAX_SHOWN_EXTENTS = 2.0

_TRAJECTORY_CAPTION = (
    "Trajectory of the camera (as the paper's Figure 10), from above and from the right: "
    "{gray}the methods' estimates in color, all aligned at the first frame. A gap in a line means "
    "that frames were lost."
)
GROUND_TRUTH_CAPTION = "the truth in gray, "


@dataclass(frozen=True)
class NamedFigure:
    """Figure with the suffix of its file name and a caption."""

    name: str
    caption: str
    figure: "Figure"

    def render(self, file_format: str) -> bytes:
        """Return the content of a file, "svg" or "png". The same figure gives the same bytes."""
        from matplotlib import rc_context

        metadata = {"svg": {"Date": None, "Creator": None}, "png": {"Software": None}}[file_format]
        with rc_context({"svg.hashsalt": self.name}):
            return render_figure(self.figure, file_format, dpi=120, metadata=metadata)


def line_style(result: SequenceResults, method: str) -> dict[str, Any]:
    """Return the color and dashes of a method; ours are the same in all figures and reports."""
    if method in METHOD_COLORS:
        return {"color": METHOD_COLORS[method], "linestyle": "-"}
    number = [other for other in result.evaluations if other not in METHOD_COLORS].index(method)
    dashes, color = divmod(number, len(OTHER_METHOD_COLORS))
    return {
        "color": OTHER_METHOD_COLORS[color],
        "linestyle": OTHER_LINE_STYLES[dashes % len(OTHER_LINE_STYLES)],
    }


def make_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    """Yield all figures for which the results are sufficient."""
    yield from make_error_figures(result)
    yield from make_trajectory_figures(result)


def make_error_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    """Yield the figures of step errors and global errors; none without an evaluation."""
    poses = {
        method: evaluation.matched
        for method, evaluation in result.evaluations.items()
        if evaluation.matched is not None
    }
    if poses:
        yield NamedFigure("frame_error", _FRAME_CAPTION, _draw_step_errors(result, poses))
        yield NamedFigure("global_error", _GLOBAL_CAPTION, _draw_global_errors(result, poses))


_FRAME_CAPTION = (
    "Error frame by frame (as the paper's Figures 6 to 9): the error of the motion from each frame "
    "to the next, in millimeters and in degrees. Low is good; a peak is one bad step. Thin lines "
    f"are single frames, thick lines the median of {SMOOTHING_FRAMES} frames. The scale is "
    "logarithmic. Marks at the bottom, if any, are frames without a pose."
)
_GLOBAL_CAPTION = (
    "Global error (as the paper's Figures 6 to 9): the distance between the estimated and the true "
    "camera, with both trajectories aligned at the first frame. Errors of single steps add up, "
    "so the lines drift; their mean is the mean global error. Marks at the bottom, if "
    "any, are frames without a pose."
)


def _draw_step_errors(result: SequenceResults, poses: Mapping[str, MatchedPoses]) -> "Figure":
    figure = new_figure(10, 6.5)
    above, below = figure.subplots(2, 1, sharex=True)
    label_axes(above, "", "", "error of a step (mm)")
    label_axes(below, "", "frame", "error of a step (degrees)")
    for method, matched in poses.items():
        errors = relative_errors(matched, consecutive_pairs(matched))
        style, steps_s = line_style(result, method), matched.stamps_s[1:]
        _draw_smoothed(above, result, steps_s, 1e3 * errors.translation_m, style)
        _draw_smoothed(below, result, steps_s, errors.rotation_deg, style)
    for plot in (above, below):
        _set_log_scale(plot)
    _draw_annotations(figure, result, poses)
    return figure


def _draw_global_errors(result: SequenceResults, poses: Mapping[str, MatchedPoses]) -> "Figure":
    figure = new_figure(10, 4.5)
    plot = figure.subplots()
    errors_m = {
        method: position_errors_m(matched, first_pose_alignment(matched))
        for method, matched in poses.items()
    }
    largest = [float(values.max()) for values in errors_m.values()]
    is_log = max(largest) > MAX_LINEAR_RATIO * min(largest) > 0
    label_axes(plot, "", "frame", "distance from the truth (m)" + ", logarithmic" * is_log)
    for method, values in errors_m.items():
        shown = _mask_non_positive(values) if is_log else values
        _draw_values(plot, result, poses[method].stamps_s, shown, line_style(result, method))
    if is_log:
        _set_log_scale(plot)
    else:
        plot.set_ylim(bottom=0)
    _draw_annotations(figure, result, poses)
    return figure


def _draw_smoothed(
    plot: "Axes", result: SequenceResults, stamps_s: Array, values: Array, style: dict[str, Any]
) -> None:
    """Draw the values as a thin line and their median as a thick one, without lost frames."""
    middle = slice(None)
    if len(values) >= SMOOTHING_FRAMES:
        _draw_values(plot, result, stamps_s, _mask_non_positive(values), style | THIN_STYLE)
        windows = np.lib.stride_tricks.sliding_window_view(values, SMOOTHING_FRAMES)
        middle = slice(SMOOTHING_FRAMES // 2, SMOOTHING_FRAMES // 2 + len(windows))
        values = np.median(windows, axis=1)
    _draw_values(plot, result, stamps_s[middle], _mask_non_positive(values), style | THICK_STYLE)


def _draw_values(
    plot: "Axes", result: SequenceResults, stamps_s: Array, values: Array, style: dict[str, Any]
) -> None:
    """Draw a line over the frames' numbers, without lost frames."""
    line = np.column_stack([_frame_numbers(result, stamps_s), values])
    plot.plot(*insert_nan_at_gaps(stamps_s, line).T, **style)


def _set_log_scale(plot: "Axes") -> None:
    """Set a logarithmic axis with plain numbers; do nothing without positive values."""
    if not np.isfinite(plot.dataLim.minposy):
        return
    plot.set_yscale("log")
    plot.yaxis.set_major_formatter(lambda value, position: f"{value:g}")


def _mask_non_positive(values: Array) -> Array:
    """Replace values that a logarithmic axis cannot show by NaN."""
    return np.where(values > 0, values, np.nan)


def _draw_lost_frames(plot: "Axes", result: SequenceResults) -> None:
    """Draw one row of marks at the bottom of the plot per method with lost frames."""
    logs = {m: evaluation.outcome.run.frames for m, evaluation in result.evaluations.items()}
    for row, method in enumerate(m for m, log in logs.items() if not log["has_pose"].all()):
        log = logs[method]
        frames = _frame_numbers(result, log["stamp_s"][~log["has_pose"]])
        heights = np.full(len(frames), 0.015 + 0.03 * row)
        plot.plot(
            frames, heights, "|",
            color=line_style(result, method)["color"], markersize=5,
            transform=plot.get_xaxis_transform(), clip_on=True, zorder=3,
        )  # fmt: skip


def _frame_numbers(result: SequenceResults, stamps_s: Array) -> Array:
    """Return the numbers of the recording's frames at these stamps, from 0."""
    return nearest_indices(result.recording.frame_stamps_s, stamps_s).astype(np.float64)


def _draw_annotations(figure: "Figure", result: SequenceResults, methods: Iterable[str]) -> None:
    """Draw lost frames and pauses into all plots, and the legend above them."""
    from matplotlib.lines import Line2D

    for plot in figure.axes:
        _draw_lost_frames(plot, result)
        for gap in result.recording.gaps:
            plot.axvline(float(_frame_numbers(result, np.array([gap.end_s]))[0]) - 0.5, **GAP_STYLE)
        plot.set_xlim(-0.5, len(result.recording.frame_stamps_s) - 0.5)
    handles = [
        Line2D([], [], **line_style(result, method), linewidth=2, label=method)
        for method in methods
    ]
    if any(evaluation.outcome.run.failed for evaluation in result.evaluations.values()):
        handles.append(Line2D([], [], color="0.3", marker="|", linestyle="", label="frame lost"))
    if result.recording.gaps:
        handles.append(Line2D([], [], **GAP_STYLE, label="pause in the recording"))
    _place_legend(figure, handles)


def _place_legend(figure: "Figure", handles: "Sequence[Artist]") -> None:
    """Place a legend above the plots, in as many rows as it needs."""
    columns = min(len(handles), MAX_LEGEND_COLUMNS)
    figure.legend(handles=handles, loc="outside upper center", ncols=columns, frameon=False)


def make_trajectory_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    """Yield one figure if any method has two poses."""
    truth = _find_ground_truth(result)
    T_first_truth = np.eye(4) if truth is None else inverse(truth.T_world_camera[0])
    trajectories = {}
    for method, evaluation in result.evaluations.items():
        poses, matched = evaluation.outcome.run.trajectory, evaluation.matched
        if len(poses) >= 2:  # without a truth it stays in the frame of its first camera
            T_truth_world = None if matched is None else first_pose_alignment(matched)
            T_first_world = np.eye(4) if T_truth_world is None else T_first_truth @ T_truth_world
            trajectories[method] = _transform(T_first_world, poses)
    if trajectories:
        caption = _TRAJECTORY_CAPTION.format(gray="" if truth is None else GROUND_TRUTH_CAPTION)
        shown = None if truth is None else _transform(T_first_truth, truth)
        yield NamedFigure("trajectory", caption, _draw_trajectories(result, trajectories, shown))


def _find_ground_truth(result: SequenceResults) -> Trajectory | None:
    """Return the truth during the recording, if any method is compared with it."""
    truth = result.recording.truth
    if truth is None or all(each.matched is None for each in result.evaluations.values()):
        return None
    return crop_trajectory(truth, *result.recording.frame_stamps_s[[0, -1]])


def _transform(T_new_old: Array, poses: Trajectory) -> Trajectory:
    return Trajectory(poses.stamps_s, T_new_old @ poses.T_world_camera)


def _draw_trajectories(
    result: SequenceResults, trajectories: Mapping[str, Trajectory], truth: Trajectory | None
) -> "Figure":
    figure = new_figure(10, 5)
    plots = figure.subplot_mosaic("AB")
    label_axes(plots["A"], "from above", "right (m)", "forward (m)")
    label_axes(plots["B"], "from the right", "forward (m)", "up (m)")
    for plot in plots.values():
        plot.set_aspect("equal", adjustable="datalim")
    if truth is not None:
        draw_trajectory(plots, truth, np.eye(4), GROUND_TRUTH_STYLE)
    bounds_m = _shown_bounds_m(truth)
    outside = [name for name, poses in trajectories.items() if not _is_within(poses, bounds_m)]
    for method, poses in trajectories.items():
        label = f"{method} (leaves the figure)" if method in outside else method
        style = {**line_style(result, method), "linewidth": 1.3, "label": label}
        draw_trajectory(plots, poses, np.eye(4), style)
    if outside:
        right, down, forward = bounds_m.T
        plots["A"].set(xlim=right, ylim=forward)
        plots["B"].set(xlim=forward, ylim=(-down[1], -down[0]))
        for plot in plots.values():
            plot.set_aspect("equal", adjustable="box")
    _place_legend(figure, plots["A"].get_legend_handles_labels()[0])
    return figure


def _shown_bounds_m(truth: Trajectory | None) -> Array:
    """Return (2, 3) minimum and maximum of x, y, z to show, m; without a truth there are none."""
    if truth is None:
        return np.array([[-np.inf] * 3, [np.inf] * 3])
    positions_m = truth.T_world_camera[:, :3, 3]
    low_m, high_m = positions_m.min(axis=0), positions_m.max(axis=0)
    center_m = (low_m + high_m) / 2
    half_extent_m = MAX_SHOWN_EXTENTS / 2 * max(float(np.max(high_m - low_m)), 0.1)
    return np.array([center_m - half_extent_m, center_m + half_extent_m])


def _is_within(poses: Trajectory, bounds_m: Array) -> bool:
    positions_m = poses.T_world_camera[:, :3, 3]
    return bool(np.all((positions_m >= bounds_m[0]) & (positions_m <= bounds_m[1])))

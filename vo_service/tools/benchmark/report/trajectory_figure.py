"""Figure of all methods' trajectories and the truth, as the paper's Figure 10."""

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.core.geometry import Array, inverse
from drivers.core.trajectory import Trajectory
from vo_service.tools.benchmark.report.error_figures import NamedFigure, method_color, new_figure
from vo_service.tools.benchmark.report.published_results import describe_method
from vo_service.tools.benchmark.results import SequenceResults
from vo_service.tools.evaluation.metrics import first_pose_alignment
from vo_service.tools.evaluation.plot import (
    GROUND_TRUTH_STYLE,
    crop_trajectory,
    draw_trajectory,
    label_axes,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# The figure shows at most this many times the extent of the truth. Otherwise one diverging method
# would shrink all others to a dot.
MAX_SHOWN_EXTENTS = 2.0

CAPTION = (
    "Trajectory of the camera (as the paper's Figure 10), from above and from the right: "
    "{gray}the methods' estimates in color, all aligned at the first frame. A gap in a line means "
    "that frames were lost."
)
GROUND_TRUTH_CAPTION = "the truth in gray, "


def make_trajectory_figures(result: SequenceResults) -> Iterator[NamedFigure]:
    """Yield one figure if any method has two poses."""
    trajectories = dict(_aligned_trajectories(result))
    if trajectories:
        truth = _cropped_ground_truth(result)
        caption = CAPTION.format(gray="" if truth is None else GROUND_TRUTH_CAPTION)
        yield NamedFigure("trajectory", caption, _draw(result, trajectories, truth))


def _aligned_trajectories(result: SequenceResults) -> Iterator[tuple[str, Trajectory]]:
    """Yield trajectories in the frame of the first true camera, or in their own without a truth."""
    for method, evaluation in result.evaluations.items():
        poses = evaluation.outcome.run.trajectory
        if len(poses) < 2:
            continue
        T_first_world = np.eye(4)
        if evaluation.matched is not None:
            T_first_truth = inverse(_first_ground_truth_pose(result))
            T_first_world = T_first_truth @ first_pose_alignment(evaluation.matched)
        yield method, Trajectory(poses.stamps_s, T_first_world @ poses.T_world_camera)


def _cropped_ground_truth(result: SequenceResults) -> Trajectory | None:
    """Return the truth during the recording, in the frame of its first camera."""
    if not any(evaluation.matched is not None for evaluation in result.evaluations.values()):
        return None
    assert result.recording.truth is not None
    first_s, last_s = result.recording.frame_stamps_s[[0, -1]]
    during = crop_trajectory(result.recording.truth, first_s, last_s)
    return Trajectory(
        during.stamps_s, inverse(_first_ground_truth_pose(result)) @ during.T_world_camera
    )


def _first_ground_truth_pose(result: SequenceResults) -> Array:
    """Return T_truth_camera of the earliest matched pose of any method."""
    matched = [j.matched for j in result.evaluations.values() if j.matched is not None]
    first = min(matched, key=lambda poses: float(poses.stamps_s[0]))
    T_truth_camera: Array = first.T_truth_camera[0]
    return T_truth_camera


def _draw(
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
    bounds_m = None if truth is None else _shown_bounds_m(truth)
    for method, poses in trajectories.items():
        suffix = "" if bounds_m is None or _is_within(poses, bounds_m) else " (leaves the figure)"
        style: dict[str, Any] = {
            "color": method_color(method, list(result.evaluations)),
            "linewidth": 1.3,
            "label": describe_method(method).name + suffix,
        }
        draw_trajectory(plots, poses, np.eye(4), style)
    if bounds_m is not None and not all(
        _is_within(poses, bounds_m) for poses in trajectories.values()
    ):
        _limit_axes(plots, bounds_m)
    handles, labels = plots["A"].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=len(labels), frameon=False)
    return figure


def _shown_bounds_m(truth: Trajectory) -> Array:
    """Return (2, 3) minimum and maximum of x, y, z to show, m."""
    positions_m = truth.T_world_camera[:, :3, 3]
    low_m, high_m = positions_m.min(axis=0), positions_m.max(axis=0)
    center_m = (low_m + high_m) / 2
    half_extent_m = MAX_SHOWN_EXTENTS / 2 * max(float(np.max(high_m - low_m)), 0.1)
    return np.array([center_m - half_extent_m, center_m + half_extent_m])


def _is_within(poses: Trajectory, bounds_m: Array) -> bool:
    positions_m = poses.T_world_camera[:, :3, 3]
    return bool(np.all((positions_m >= bounds_m[0]) & (positions_m <= bounds_m[1])))


def _limit_axes(plots: "dict[str, Axes]", bounds_m: Array) -> None:
    (right, down, forward) = bounds_m.T
    plots["A"].set(xlim=right, ylim=forward)
    plots["B"].set(xlim=forward, ylim=(-down[1], -down[0]))
    for plot in plots.values():
        plot.set_aspect("equal", adjustable="box")

"""Figure of a trajectory and its ground truth: top view, side view, error over time."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.core.geometry import (
    MAX_STAMP_DIFFERENCE_S,
    Array,
    Trajectory,
    inverse,
    transform_points,
)
from vo_service.figures import new_figure, write_figure
from vo_service.tools.evaluation.metrics import associate, best_alignment, position_errors_m

if TYPE_CHECKING:  # rarely used, and slow to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg")
# A line is interrupted where poses are further apart than this many median steps.
MIN_GAP_STEPS = 3.0
GROUND_TRUTH_STYLE: dict[str, Any] = {"color": "0.55", "linewidth": 2.5, "label": "ground truth"}
TRAJECTORY_STYLE: dict[str, Any] = {"color": "tab:blue", "linewidth": 1.2, "label": "trajectory"}


def write_plot(
    path: Path,
    trajectory: Trajectory,
    truth: Trajectory,
    title: str,
    max_difference_s: float = MAX_STAMP_DIFFERENCE_S,
) -> None:
    """Draw both after the best rigid alignment, in meters, and write a PNG or SVG by the suffix.

    The axes are those of the first true camera: right, forward, up. No partial file is left.

    Raises:
        InputError: Another suffix, fewer than 3 poses with ground truth, or no file can have this
            name.
        WriteError: The file cannot be written.
    """
    write_figure(path, FORMATS, lambda: draw_plot(trajectory, truth, title, max_difference_s))


def draw_plot(
    trajectory: Trajectory,
    truth: Trajectory,
    title: str,
    max_difference_s: float = MAX_STAMP_DIFFERENCE_S,
) -> "Figure":
    """Draw the matplotlib figure of `write_plot`."""
    matched = associate(trajectory, truth, max_difference_s)
    T_truth_world = best_alignment(matched)
    T_first_truth = inverse(matched.T_truth_camera[0])
    figure = new_figure(11, 8)
    figure.suptitle(title)
    plots = figure.subplot_mosaic("AB;EE", height_ratios=[3, 1])
    label_axes(plots["A"], "from above", "right (m)", "forward (m)")
    label_axes(plots["B"], "from the right", "forward (m)", "up (m)")
    label_axes(plots["E"], "position error after alignment", "time (s)", "error (m)")
    truth_during_run = crop_trajectory(truth, *matched.stamps_s[[0, -1]])
    draw_trajectory(plots, truth_during_run, T_first_truth, GROUND_TRUTH_STYLE)
    draw_trajectory(plots, trajectory, T_first_truth @ T_truth_world, TRAJECTORY_STYLE)
    for view in (plots["A"], plots["B"]):
        view.set_aspect("equal", adjustable="datalim")
    plots["A"].legend()
    errors_m = position_errors_m(matched, T_truth_world)
    time_s = matched.stamps_s - matched.stamps_s[0]
    plots["E"].plot(*insert_nan_at_gaps(matched.stamps_s, np.column_stack([time_s, errors_m])).T)
    plots["E"].set_ylim(bottom=0)
    return figure


def label_axes(plot: "Axes", title: str, x: str, y: str) -> None:
    """Set the title, the axis labels and a grid."""
    plot.set(title=title, xlabel=x, ylabel=y)
    plot.grid(alpha=0.3)


def draw_trajectory(
    plots: "dict[str, Axes]", poses: Trajectory, T_first_world: Array, style: dict[str, Any]
) -> None:
    """Draw into the views "A" from above and "B" from the right.

    Args:
        T_first_world: (4, 4) from its world to the first true camera.
    """
    positions_m = transform_points(T_first_world, poses.T_world_camera[:, :3, 3])
    right_m, down_m, forward_m = insert_nan_at_gaps(poses.stamps_s, positions_m).T
    plots["A"].plot(right_m, forward_m, **style)
    plots["B"].plot(forward_m, -down_m, **style)


def crop_trajectory(poses: Trajectory, begin_s: float, end_s: float) -> Trajectory:
    """Return the poses between two stamps; motion capture may start long before the trajectory."""
    during = (poses.stamps_s >= begin_s - MAX_STAMP_DIFFERENCE_S) & (
        poses.stamps_s <= end_s + MAX_STAMP_DIFFERENCE_S
    )
    return Trajectory(poses.stamps_s[during], poses.T_world_camera[during])


def insert_nan_at_gaps(stamps_s: Array, columns: Array) -> Array:
    """Return `columns` (N, k) with a row of NaN at each gap, so that no line is drawn there."""
    if len(stamps_s) < 2:
        return columns
    steps_s = np.diff(stamps_s)
    gaps = np.flatnonzero(steps_s > MIN_GAP_STEPS * np.median(steps_s))
    return np.insert(columns, gaps + 1, np.nan, axis=0)

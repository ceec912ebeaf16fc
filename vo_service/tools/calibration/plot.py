"""Figure of a calibration: the corners and their residuals.

Residuals are enlarged; equal directions over a whole region are not noise.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.geometry import Array
from vo_service.figures import new_figure, write_figure
from vo_service.tools.calibration.calibration_result import CalibrationResult
from vo_service.tools.calibration.color_camera import ColorCalibrationResult
from vo_service.tools.calibration.depth_camera import DepthCalibrationResult
from vo_service.tools.calibration.view_selection import (
    MIN_ZONE_CORNERS,
    ZONE_EDGES,
    convex_outline,
    count_zone_corners,
)

if TYPE_CHECKING:  # rarely used, and slow to import
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FORMATS = (".png", ".svg")
# Length of an arrow for the rms error, relative to the image's width.
ARROW_LENGTH_RATIO = 0.025
# Range of the color scale of depth residuals, in rms errors.
MAX_RESIDUAL_SIGMAS = 2.5


def write_plot(path: Path, calibration: CalibrationResult) -> None:
    """Write the figure. Raises InputError for an unknown suffix, WriteError for the disk."""
    write_figure(path, FORMATS, lambda: draw_plot(calibration), dpi=110)


def draw_plot(calibration: CalibrationResult) -> "Figure":
    """Draw the figure: a row of plots for each camera."""
    color, rows = calibration.color, 1 + len(calibration.depth)
    figure = new_figure(13, 5.2 * rows)
    figure.suptitle(f"{len(color.views)} views of a {calibration.board.name}")
    plots = figure.subplots(rows, 2, width_ratios=[1.55, 1], squeeze=False)
    _draw_corners(plots[0, 0], color)
    _draw_bars(plots[0, 1], color.view_rms_px, "error in each view", "px")
    for depth, (image, bars) in zip(calibration.depth, plots[1:], strict=True):
        _draw_readings(figure, image, depth)
        errors_mm = _view_rms_mm(depth, len(color.views))
        _draw_bars(bars, errors_mm, "depth error in each view", "mm")
    return figure


def _draw_corners(plot: "Axes", color: ColorCalibrationResult) -> None:
    """Draw outlines of the boards, corners, and arrows of their residuals."""
    _set_image_axes(plot, color.size)
    _draw_zones(plot, color)
    for view in color.views:
        plot.fill(*convex_outline(view.corners.pixels).T, facecolor="tab:blue", alpha=0.05)
    pixels = np.concatenate([view.corners.pixels for view in color.views])
    residuals = np.concatenate(color.residuals_px)
    magnification = ARROW_LENGTH_RATIO * color.size[0] / max(color.rms_px, 1e-3)
    magnification = float(f"{magnification:.1g}")  # one significant digit: 300 for 329
    columns, rows = pixels.T
    plot.scatter(columns, rows, s=3, color="tab:blue", linewidths=0)
    plot.quiver(
        *pixels.T, *residuals.T, angles="xy", scale_units="xy", scale=1 / magnification,
        width=0.0013, color="tab:red", alpha=0.8,
    )  # fmt: skip
    plot.set_title(
        f"corners, and {color.rms_px:.2f} px of error, enlarged {magnification:.0f} times"
    )


def _draw_zones(plot: "Axes", color: ColorCalibrationResult) -> None:
    """Draw the zones, those with hardly any corner in gray."""
    from matplotlib.patches import Rectangle

    edges = np.array([0.0, *ZONE_EDGES, 1.0])
    columns, rows = (edges * length - 0.5 for length in color.size)
    for (row, column), count in np.ndenumerate(count_zone_corners(color.views)):
        is_empty = count < MIN_ZONE_CORNERS
        corner = (float(columns[column]), float(rows[row]))
        width, height = columns[column + 1] - corner[0], rows[row + 1] - corner[1]
        face = "0.8" if is_empty else "none"
        plot.add_patch(Rectangle(corner, width, height, facecolor=face, edgecolor="0.85", zorder=0))
        if is_empty:
            center = (corner[0] + width / 2, corner[1] + height / 2)
            plot.text(*center, "few corners", ha="center", va="center", color="0.35")


def _draw_readings(figure: "Figure", plot: "Axes", depth: DepthCalibrationResult) -> None:
    """Draw the used depth readings, colored by their distance from the board."""
    height, width = depth.pixels.shape
    _set_image_axes(plot, (width, height))
    pixels, residuals_mm = depth.pixels.pixels[depth.is_used], 1e3 * depth.residuals_m
    limit = MAX_RESIDUAL_SIGMAS * 1e3 * depth.rms_m
    columns, rows = pixels.T
    dots = plot.scatter(
        columns,
        rows, c=residuals_mm[depth.is_used], s=4, linewidths=0,
        cmap="coolwarm", vmin=-limit, vmax=limit,
    )  # fmt: skip
    figure.colorbar(dots, ax=plot, label="depth beyond the board (mm)", shrink=0.85)
    plot.set_title(f"depth readings on the boards, {1e3 * depth.rms_m:.1f} mm of error")


def _set_image_axes(plot: "Axes", size: tuple[int, int]) -> None:
    """Set the axes to the image's edges, with row 0 at the top."""
    width, height = size
    plot.set_anchor("W")
    plot.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    plot.set_xlabel("column (px)")
    plot.set_ylabel("row (px)")


def _draw_bars(plot: "Axes", errors: Array, title: str, unit: str) -> None:
    """Draw one bar per view, with a line at the median."""
    median = float(np.median(errors[errors > 0]))
    plot.bar(np.arange(1, len(errors) + 1), errors, color="tab:blue", alpha=0.75)
    plot.axhline(median, color="0.4", linewidth=1, linestyle="--")
    plot.set(xlabel="view", ylabel=f"{unit} (rms)", xlim=(0.3, len(errors) + 0.7))
    plot.set_title(f"{title}: median {median:.2f} {unit}")
    plot.grid(axis="y", alpha=0.3)


def _view_rms_mm(depth: DepthCalibrationResult, count: int) -> Array:
    """Return the rms error (count,) of each view's used readings, mm; 0 without readings."""
    numbers = depth.pixels.view_number[depth.is_used]
    squares = np.bincount(numbers, (1e3 * depth.residuals_m[depth.is_used]) ** 2, count)
    readings = np.bincount(numbers, minlength=count)
    rms: Array = np.sqrt(squares / np.maximum(readings, 1))
    return rms

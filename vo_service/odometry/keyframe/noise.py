"""What the readings' noise alone would say of the motion, and how sure the readings make it."""

import numpy as np

from drivers.geometry import Array
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.cells import CELLS
from vo_service.odometry.keyframe.movement import UNKNOWNS
from vo_service.odometry.keyframe.parameters import BRIGHTNESS_SHARE, FREEDOM, SLOPE_NOISE
from vo_service.odometry.keyframe.points import (
    BRIGHTNESS,
    HAS_SHAPE,
    HAS_TEXTURE,
    TO_BRIGHTNESS,
    TO_DEPTH,
    VARIANCE,
)
from vo_service.odometry.keyframe.readings import BANDS
from vo_service.odometry.keyframe.system import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
    jacobian,
)


@kernel
def weigh(
    points: Array,
    readings: Array,
    weights: Array,
    fit: Array,
    readout_s: float,
    skew_s: float,
    focal_px: float,
    depth_focal_px: float,
) -> tuple[Array, Array]:
    """(CELLS, 15) what each cell pulls the motion and the movement by, and moments (4, 4).

    A cell's pull is sum w J' r, see `with_times`. The moments are sum w v^2 q q^T, with q
    the point (x, y, z, 1) and v^2 the variance of its derivative for the noise of its slopes.
    """
    pulls, moments = np.zeros((CELLS, UNKNOWNS)), np.zeros((4, 4))
    J, q = np.empty(6), np.ones(4)
    gain, offset = fit[GAIN], fit[OFFSET]
    variance, variance_depth = fit[SIGMA_BRIGHTNESS] ** 2, fit[SIGMA_DEPTH] ** 2
    for i in range(len(points)):
        brightness = readings[i, reading_columns.BRIGHTNESS]
        depth = readings[i, reading_columns.DEPTH]
        cell = int(readings[i, reading_columns.CELL])
        noise = 0.0
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, BRIGHTNESS] - offset
            of_this = variance + points[i, VARIANCE]
            w = (FREEDOM + 1.0) / (FREEDOM + residual * residual / of_this) / of_this
            w *= BRIGHTNESS_SHARE * weights[0, cell]
            noise += w * (gain * SLOPE_NOISE[0] * focal_px / points[i, 2]) ** 2
            jacobian(points[i], TO_BRIGHTNESS, gain, J)
            row = (readings[i, reading_columns.COLOUR_BAND] + 0.5) / BANDS - 0.5
            _pull(pulls[cell], J, row * readout_s, w * residual)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = (FREEDOM + 1.0) / (FREEDOM + depth * depth / variance_depth) / variance_depth
            w *= weights[1, cell]
            noise += w * (SLOPE_NOISE[1] * depth_focal_px / points[i, 2]) ** 2
            jacobian(points[i], TO_DEPTH, 1.0, J)
            row = (readings[i, reading_columns.DEPTH_BAND] + 0.5) / BANDS - 0.5
            _pull(pulls[cell], J, row * readout_s + skew_s, w * depth)
        if noise > 0.0:
            q[:3] = points[i, :3]
            for a in range(4):
                for b in range(4):
                    moments[a, b] += noise * q[a] * q[b]
    return pulls, moments


@inline_kernel
def _pull(pulls: Array, J: Array, tau: float, weighted: float) -> None:
    """Add what a reading of a time, by its weighted residual, pulls by."""
    for k in range(6):
        pulls[k] += weighted * J[k]
        pulls[6 + k] += tau * weighted * J[k]
        if k >= 3:
            pulls[9 + k] += 0.5 * tau * tau * weighted * J[k]

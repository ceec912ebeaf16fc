"""What the readings' noise alone would say of the motion, and how sure the readings make it."""

import numpy as np

from drivers.geometry import Array
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.cells import NUM_CELLS
from vo_service.odometry.keyframe.movement import NUM_UNKNOWNS
from vo_service.odometry.keyframe.parameters import (
    BRIGHTNESS_WEIGHT,
    DEGREES_OF_FREEDOM,
    SLOPE_NOISE,
)
from vo_service.odometry.keyframe.points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
)
from vo_service.odometry.keyframe.readings import NUM_ROW_BANDS
from vo_service.odometry.keyframe.system import (
    GAIN,
    OFFSET,
    SIGMA_BRIGHTNESS,
    SIGMA_DEPTH,
    fill_jacobian,
)


@kernel
def accumulate_scores(
    points: Array,
    samples: Array,
    cell_weights: Array,
    residual_model: Array,
    readout_s: float,
    skew_s: float,
    focal_px: float,
    depth_focal_px: float,
) -> tuple[Array, Array]:
    """(CELLS, 15) what each cell pulls the motion and the movement by, and moments (4, 4).

    A cell's pull is sum w J' r, see `expand_rolling_shutter`. The moments are sum w v^2 q q^T, with q
    the point (x, y, z, 1) and v^2 the variance of its derivative for the noise of its slopes.
    """
    pulls, moments = np.zeros((NUM_CELLS, NUM_UNKNOWNS)), np.zeros((4, 4))
    J, q = np.empty(6), np.ones(4)
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness = samples[i, reading_columns.SAMPLE_BRIGHTNESS]
        depth = samples[i, reading_columns.SAMPLE_DEPTH_RESIDUAL]
        cell = int(samples[i, reading_columns.SAMPLE_CELL])
        noise = 0.0
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, POINT_BRIGHTNESS] - offset
            of_this = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + residual * residual / of_this)
                / of_this
            )
            w *= BRIGHTNESS_WEIGHT * cell_weights[0, cell]
            noise += w * (gain * SLOPE_NOISE[0] * focal_px / points[i, 2]) ** 2
            fill_jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain, J)
            row = (samples[i, reading_columns.SAMPLE_COLOR_BAND] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(pulls[cell], J, row * readout_s, w * residual)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + depth * depth / variance_depth)
                / variance_depth
            )
            w *= cell_weights[1, cell]
            noise += w * (SLOPE_NOISE[1] * depth_focal_px / points[i, 2]) ** 2
            fill_jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0, J)
            row = (samples[i, reading_columns.SAMPLE_DEPTH_BAND] + 0.5) / NUM_ROW_BANDS - 0.5
            _add_score(pulls[cell], J, row * readout_s + skew_s, w * depth)
        if noise > 0.0:
            q[:3] = points[i, :3]
            for a in range(4):
                for b in range(4):
                    moments[a, b] += noise * q[a] * q[b]
    return pulls, moments


@inline_kernel
def _add_score(scores: Array, J: Array, delay_s: float, weighted_residual: float) -> None:
    """Add what a reading of a time, by its weighted residual, pulls by."""
    for k in range(6):
        scores[k] += weighted_residual * J[k]
        scores[6 + k] += delay_s * weighted_residual * J[k]
        if k >= 3:
            scores[9 + k] += 0.5 * delay_s * delay_s * weighted_residual * J[k]

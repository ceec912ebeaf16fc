"""Weights of image regions: cells that move by themselves do not fit."""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.grid import NUM_CELLS
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.normal_equations import GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.parameters import MAX_REGION_COST_RATIO, MIN_CELL_SAMPLES
from vo_service.odometry.direct.residual_stats import MAX_SQUARED_RESIDUAL
from vo_service.odometry.direct.warping import (
    OCCLUDED,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_OCCLUSION,
)


@kernel
def weigh_regions(
    points: Array, samples: Array, residual_model: Array, base_weights: Array
) -> Array:
    """(2, CELLS) weights: the base weights, lowered where a cell fits worse than most cells do.

    Robust statistics handle single outliers. A moving object gives many samples that agree with
    each other, so it has to be detected as a region.
    """
    sums, counts = np.zeros(NUM_CELLS), np.zeros(NUM_CELLS)
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        cell = int(samples[i, SAMPLE_CELL])
        if cell < 0 or samples[i, SAMPLE_OCCLUSION] == OCCLUDED:
            continue
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        depth = samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            sums[cell] += MAX_SQUARED_RESIDUAL
            counts[cell] += 1.0
            continue
        if points[i, HAS_TEXTURE] > 0 and base_weights[0, cell] > 0:
            residual = (
                brightness
                - residual_model[GAIN] * points[i, POINT_BRIGHTNESS]
                - residual_model[OFFSET]
            )
            squared = residual * residual / (variance + points[i, POINT_BRIGHTNESS_VARIANCE])
            sums[cell] += min(squared, MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
        if points[i, HAS_SHAPE] > 0 and not np.isnan(depth):
            sums[cell] += min(depth * depth / variance_depth, MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
    means = np.full(NUM_CELLS, -1.0)
    for cell in range(NUM_CELLS):
        if counts[cell] >= MIN_CELL_SAMPLES:
            means[cell] = sums[cell] / counts[cell]
    weights = base_weights.copy()
    valid_means = means[means >= 0.0]
    if len(valid_means) == 0:
        return weights
    max_mean = MAX_REGION_COST_RATIO * np.median(valid_means)
    for cell in range(NUM_CELLS):
        if means[cell] > max_mean:
            factor = (max_mean / means[cell]) ** 2
            weights[0, cell] *= factor
            weights[1, cell] *= factor
    return weights

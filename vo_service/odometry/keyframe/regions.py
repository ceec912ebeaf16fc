"""Regions of the view that move by themselves: whole cells of the image that do not fit."""

import numpy as np

from drivers.geometry import Array
from drivers.jit import kernel
from vo_service.odometry.keyframe import readings as reading_columns
from vo_service.odometry.keyframe.cells import CELLS
from vo_service.odometry.keyframe.measure import AGREEING
from vo_service.odometry.keyframe.parameters import ODD_REGION
from vo_service.odometry.keyframe.points import BRIGHTNESS, HAS_SHAPE, HAS_TEXTURE, VARIANCE
from vo_service.odometry.keyframe.readings import HIDDEN
from vo_service.odometry.keyframe.system import GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH

# Cells with fewer readings are not judged.
FEWEST_READINGS = 10


@kernel
def weigh_regions(points: Array, readings: Array, fit: Array, basic: Array) -> Array:
    """(2, CELLS) weights: the basic ones, lowered where a cell fits worse than most cells do.

    A single reading that does not fit is an outlier, and robust statistics deal with it. Things
    that move by themselves are many readings that agree with each other: they have to be seen as
    regions.
    """
    sums, counts = np.zeros(CELLS), np.zeros(CELLS)
    variance, variance_depth = fit[SIGMA_BRIGHTNESS] ** 2, fit[SIGMA_DEPTH] ** 2
    for i in range(len(points)):
        cell = int(readings[i, reading_columns.CELL])
        if cell < 0 or readings[i, reading_columns.OTHER] == HIDDEN:
            continue
        brightness = readings[i, reading_columns.BRIGHTNESS]
        depth = readings[i, reading_columns.DEPTH]
        if np.isnan(brightness):
            sums[cell] += AGREEING
            counts[cell] += 1.0
            continue
        if points[i, HAS_TEXTURE] > 0 and basic[0, cell] > 0:
            residual = brightness - fit[GAIN] * points[i, BRIGHTNESS] - fit[OFFSET]
            squared = residual * residual / (variance + points[i, VARIANCE])
            sums[cell] += min(squared, AGREEING)
            counts[cell] += 1.0
        if points[i, HAS_SHAPE] > 0 and not np.isnan(depth):
            sums[cell] += min(depth * depth / variance_depth, AGREEING)
            counts[cell] += 1.0
    means = np.full(CELLS, -1.0)
    for cell in range(CELLS):
        if counts[cell] >= FEWEST_READINGS:
            means[cell] = sums[cell] / counts[cell]
    weights = basic.copy()
    judged = means[means >= 0.0]
    if len(judged) == 0:
        return weights
    most = ODD_REGION * np.median(judged)
    for cell in range(CELLS):
        if means[cell] > most:
            lowered = (most / means[cell]) ** 2
            weights[0, cell] *= lowered
            weights[1, cell] *= lowered
    return weights

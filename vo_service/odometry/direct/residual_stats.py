"""What an alignment rests on: how much is seen, how much of that agrees, and how sure it makes."""

from math import log

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct import warping as reading_columns
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.normal_equations import GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.parameters import DEGREES_OF_FREEDOM, GATE_SIGMAS, HALF
from vo_service.odometry.direct.warping import OCCLUDED

# The counts: points in the image; of these, such in regions that hardly count; then by weight, such
# with a depth that counts, and such whose depth agrees to three sigma; the same of brightness; and
# the robust cost of all.
IN_IMAGE, DISREGARDED, WITH_DEPTH, DEPTH_AGREES, WITH_BRIGHTNESS, BRIGHTNESS_AGREES, COST = range(7)
# As many squared standard deviations as a reading may be off and agree. What is off by more
# counts as if by so many.
MAX_SQUARED_RESIDUAL = GATE_SIGMAS**2
# What a point costs at most, whose brightness and depth are both wrong.
MAX_POINT_COST = 2.0 * log(1.0 + MAX_SQUARED_RESIDUAL / DEGREES_OF_FREEDOM)
# A region of less weight hardly counts.
MIN_STATIC_WEIGHT = HALF


@kernel
def count_residuals(
    points: Array, samples: Array, residual_model: Array, cell_weights: Array
) -> Array:
    """Counts (7,). What another surface is seen through costs the most; what one hides, nothing."""
    counts = np.zeros(7)
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        cell = int(samples[i, reading_columns.SAMPLE_CELL])
        if cell < 0 or samples[i, reading_columns.SAMPLE_OCCLUSION] == OCCLUDED:
            continue
        by_brightness, by_depth = cell_weights[0, cell], cell_weights[1, cell]
        counts[IN_IMAGE] += 1.0
        counts[DISREGARDED] += max(by_brightness, by_depth) < MIN_STATIC_WEIGHT
        brightness = samples[i, reading_columns.SAMPLE_BRIGHTNESS]
        depth = samples[i, reading_columns.SAMPLE_DEPTH_RESIDUAL]
        is_other = np.isnan(brightness)
        if points[i, HAS_SHAPE] > 0 and (is_other or not np.isnan(depth)):
            squared = (
                MAX_SQUARED_RESIDUAL
                if is_other
                else min(depth * depth / variance_depth, MAX_SQUARED_RESIDUAL)
            )
            counts[WITH_DEPTH] += by_depth
            counts[DEPTH_AGREES] += by_depth * (squared < MAX_SQUARED_RESIDUAL)
            counts[COST] += by_depth * np.log(1.0 + squared / DEGREES_OF_FREEDOM)
        if points[i, HAS_TEXTURE] > 0:
            squared = MAX_SQUARED_RESIDUAL
            if not is_other:
                residual = (
                    brightness
                    - residual_model[GAIN] * points[i, POINT_BRIGHTNESS]
                    - residual_model[OFFSET]
                )
                squared = min(
                    residual * residual / (variance + points[i, POINT_BRIGHTNESS_VARIANCE]),
                    MAX_SQUARED_RESIDUAL,
                )
            counts[WITH_BRIGHTNESS] += by_brightness
            counts[BRIGHTNESS_AGREES] += by_brightness * (squared < MAX_SQUARED_RESIDUAL)
            counts[COST] += by_brightness * np.log(1.0 + squared / DEGREES_OF_FREEDOM)
    return counts


@kernel
def find_inliers(points: Array, samples: Array, residual_model: Array) -> NDArray[np.bool_]:
    """(N,) whether what is read of a point, of brightness and of depth, agrees with it."""
    agreeing = np.zeros(len(points), np.bool_)
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness = samples[i, reading_columns.SAMPLE_BRIGHTNESS]
        depth = samples[i, reading_columns.SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        residual = (
            brightness - residual_model[GAIN] * points[i, POINT_BRIGHTNESS] - residual_model[OFFSET]
        )
        is_lit = residual * residual < MAX_SQUARED_RESIDUAL * (
            variance + points[i, POINT_BRIGHTNESS_VARIANCE]
        )
        is_there = np.isnan(depth) or depth * depth < MAX_SQUARED_RESIDUAL * variance_depth
        agreeing[i] = (is_lit or points[i, HAS_TEXTURE] == 0) and (
            is_there or points[i, HAS_SHAPE] == 0
        )
    return agreeing

"""Statistics of the residuals: how many samples there are, and how many agree."""

from math import log

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import kernel
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.normal_equations import GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH
from vo_service.odometry.direct.parameters import (
    DEGREES_OF_FREEDOM,
    INLIER_GATE_SIGMAS,
    MIN_STATIC_WEIGHT,
)
from vo_service.odometry.direct.warping import (
    OCCLUDED,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_OCCLUSION,
)

# The counts: points in the image; points in moving regions; by weight, samples with depth, and
# those whose depth agrees within the gate; the same of brightness; the robust cost of all.
IN_IMAGE, DISREGARDED, WITH_DEPTH, DEPTH_AGREES, WITH_BRIGHTNESS, BRIGHTNESS_AGREES, COST = range(7)
# Largest squared residual of an inlier, in variances; larger ones are clipped to it.
MAX_SQUARED_RESIDUAL = INLIER_GATE_SIGMAS**2
# Cost of a point whose brightness and depth are both wrong.
MAX_POINT_COST = 2.0 * log(1.0 + MAX_SQUARED_RESIDUAL / DEGREES_OF_FREEDOM)


@kernel
def count_residuals(
    points: Array, samples: Array, residual_model: Array, cell_weights: Array
) -> Array:
    """Counts (7,) of a level's points.

    A point in free space of the frame has the largest cost; an occluded one has none.
    """
    counts = np.zeros(7)
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        cell = int(samples[i, SAMPLE_CELL])
        if cell < 0 or samples[i, SAMPLE_OCCLUSION] == OCCLUDED:
            continue
        brightness_weight, depth_weight = cell_weights[0, cell], cell_weights[1, cell]
        counts[IN_IMAGE] += 1.0
        counts[DISREGARDED] += max(brightness_weight, depth_weight) < MIN_STATIC_WEIGHT
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        depth = samples[i, SAMPLE_DEPTH_RESIDUAL]
        is_free_space = np.isnan(brightness)
        if points[i, HAS_SHAPE] > 0 and (is_free_space or not np.isnan(depth)):
            squared = (
                MAX_SQUARED_RESIDUAL
                if is_free_space
                else min(depth * depth / variance_depth, MAX_SQUARED_RESIDUAL)
            )
            counts[WITH_DEPTH] += depth_weight
            counts[DEPTH_AGREES] += depth_weight * (squared < MAX_SQUARED_RESIDUAL)
            counts[COST] += depth_weight * np.log(1.0 + squared / DEGREES_OF_FREEDOM)
        if points[i, HAS_TEXTURE] > 0:
            squared = MAX_SQUARED_RESIDUAL
            if not is_free_space:
                residual = (
                    brightness
                    - residual_model[GAIN] * points[i, POINT_BRIGHTNESS]
                    - residual_model[OFFSET]
                )
                squared = min(
                    residual * residual / (variance + points[i, POINT_BRIGHTNESS_VARIANCE]),
                    MAX_SQUARED_RESIDUAL,
                )
            counts[WITH_BRIGHTNESS] += brightness_weight
            counts[BRIGHTNESS_AGREES] += brightness_weight * (squared < MAX_SQUARED_RESIDUAL)
            counts[COST] += brightness_weight * np.log(1.0 + squared / DEGREES_OF_FREEDOM)
    return counts


@kernel
def find_inliers(points: Array, samples: Array, residual_model: Array) -> NDArray[np.bool_]:
    """(N,) whether a point's brightness and depth samples agree with it."""
    is_inlier = np.zeros(len(points), np.bool_)
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        depth = samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        residual = (
            brightness - residual_model[GAIN] * points[i, POINT_BRIGHTNESS] - residual_model[OFFSET]
        )
        brightness_agrees = residual * residual < MAX_SQUARED_RESIDUAL * (
            variance + points[i, POINT_BRIGHTNESS_VARIANCE]
        )
        depth_agrees = np.isnan(depth) or depth * depth < MAX_SQUARED_RESIDUAL * variance_depth
        is_inlier[i] = (brightness_agrees or points[i, HAS_TEXTURE] == 0) and (
            depth_agrees or points[i, HAS_SHAPE] == 0
        )
    return is_inlier

"""Residuals of a keyframe's points in a frame, and the weights of image regions.

The sigmas of brightness and depth are estimated with the motion, and so is the gain: Klose, Heise
and Knoll, "Efficient Compositional Approaches for Real-Time Robust Direct Visual Odometry" (IROS
2013).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.factor import (
    brightness_residual,
    student_negative_log,
    student_weight,
)
from vo_service.odometry.direct.image_pyramid import GAIN_RANGE, NUM_CELLS
from vo_service.odometry.direct.parameters import (
    INITIAL_SIGMAS,
    INLIER_GATE_SIGMAS,
    MAX_REGION_COST_RATIO,
    MAX_SIGMA_RATIO,
    MIN_CELL_SAMPLES,
    MIN_SIGMA_SAMPLES,
    MIN_SIGMAS,
    MIN_STATIC_WEIGHT,
)
from vo_service.odometry.direct.points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    OCCLUDED,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_OCCLUSION,
)

# The residual model: gain of the keyframe's brightness, the two sigmas, the weight of brightness
# relative to depth, the noise of a pixel's inverse depth, 1/m, and the standard deviation of the
# keyframe's brightness, gray levels.
GAIN, SIGMA_BRIGHTNESS, SIGMA_DEPTH, WEIGHT_BRIGHTNESS, DEPTH_NOISE, CONTRAST = range(6)
RESIDUAL_MODEL_SIZE = 6
# Upper bounds of the two sigmas, that of depth as a multiple of its noise.
MAX_SIGMAS = (MAX_SIGMA_RATIO * INITIAL_SIGMAS[0], MAX_SIGMA_RATIO * INITIAL_SIGMAS[1])
# The counts: points in the image that are not occluded; points in moving regions; by weight,
# samples with depth, and those whose depth agrees within the gate; the same of brightness;
# occluded points.
(
    IN_IMAGE,
    DISREGARDED,
    WITH_DEPTH,
    DEPTH_AGREES,
    WITH_BRIGHTNESS,
    BRIGHTNESS_AGREES,
    NUM_OCCLUDED,
) = range(7)
NUM_COUNTS = 7
# Largest squared residual of an inlier, in variances; larger ones are clipped to it.
MAX_SQUARED_RESIDUAL = INLIER_GATE_SIGMAS**2


@inline_kernel
def residual_variances(residual_model: Array) -> tuple[float, float]:
    """Variances of brightness and of depth by the residual model (6,)."""
    return residual_model[SIGMA_BRIGHTNESS] ** 2, residual_model[SIGMA_DEPTH] ** 2


class WeightedSamples(NamedTuple):
    """Samples that count, and their weights; all are 0 where there is none.

    The compiler vectorizes loops over these arrays.

    Attributes:
        brightness: (N,) of the points with texture, gray levels.
        brightness_weight: (N,) weight of its cell.
        depth: (N,) residual of the points with shape, 1/m.
        depth_weight: (N,) weight of its cell.
    """

    brightness: Array
    brightness_weight: Array
    depth: Array
    depth_weight: Array


@kernel
def weigh_samples(points: Array, samples: Array, cell_weights: Array) -> WeightedSamples:
    """Select the samples that count, with the weights of their cells.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        cell_weights: (2, CELLS) of brightness and of depth.
    """
    count = len(points)
    brightness, brightness_weight = np.zeros(count), np.zeros(count)
    depth, depth_weight = np.zeros(count), np.zeros(count)
    for i in range(count):
        cell = int(samples[i, SAMPLE_CELL])
        if not np.isnan(samples[i, SAMPLE_BRIGHTNESS]) and points[i, HAS_TEXTURE] > 0:
            brightness[i] = samples[i, SAMPLE_BRIGHTNESS]
            brightness_weight[i] = cell_weights[0, cell]
        if not np.isnan(samples[i, SAMPLE_DEPTH_RESIDUAL]) and points[i, HAS_SHAPE] > 0:
            depth[i] = samples[i, SAMPLE_DEPTH_RESIDUAL]
            depth_weight[i] = cell_weights[1, cell]
    return WeightedSamples(brightness, brightness_weight, depth, depth_weight)


@kernel
def fit_residual_model(points: Array, weighted: WeightedSamples, residual_model: Array) -> None:
    """Update gain, offset and sigmas of the residual model (6,) in place, by one reweighting.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        weighted: The samples of these points in a frame.
        residual_model: (6,), in and out.
    """
    weights, costs, depth_costs = _student_costs(points, weighted, residual_model)
    # Fields of a tuple cost time in a loop.
    brightness, brightness_weight, _, depth_weight = weighted
    n = chi = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    for i in range(len(points)):
        n += brightness_weight[i]
        chi += costs[i]
        w, keyframe_brightness = weights[i], points[i, POINT_BRIGHTNESS]
        skk += w * keyframe_brightness * keyframe_brightness
        skc += w * keyframe_brightness * brightness[i]
        n_depth += depth_weight[i]
        chi_depth += depth_costs[i]
    if n >= MIN_SIGMA_SAMPLES:
        sigma = residual_model[SIGMA_BRIGHTNESS] * np.sqrt(chi / n)
        residual_model[SIGMA_BRIGHTNESS] = min(max(sigma, MIN_SIGMAS[0]), MAX_SIGMAS[0])
        if skk > 0.0:
            residual_model[GAIN] = min(max(skc / skk, GAIN_RANGE[0]), GAIN_RANGE[1])
    if n_depth >= MIN_SIGMA_SAMPLES:
        sigma = residual_model[SIGMA_DEPTH] * np.sqrt(chi_depth / n_depth)
        noise = residual_model[DEPTH_NOISE]
        residual_model[SIGMA_DEPTH] = min(max(sigma, MIN_SIGMAS[1] * noise), MAX_SIGMAS[1] * noise)


@kernel
def _student_costs(
    points: Array, weighted: WeightedSamples, residual_model: Array
) -> tuple[Array, Array, Array]:
    """Weights (N,) of the brightness samples, and weighted squared residuals (N,), see above.

    The second ones are of brightness, the third ones of depth, in variances.
    """
    count = len(points)
    weights, costs, depth_costs = np.empty(count), np.empty(count), np.empty(count)
    keyframe_brightness = points[:, POINT_BRIGHTNESS]
    point_variance = points[:, POINT_BRIGHTNESS_VARIANCE]
    brightness, brightness_weight, depth, depth_weight = weighted
    gain = residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(count):
        residual = brightness_residual(brightness[i], keyframe_brightness[i], gain)
        weights[i] = brightness_weight[i] * student_weight(residual, variance + point_variance[i])
        costs[i] = weights[i] * residual * residual
        depth_costs[i] = depth_weight[i] * student_weight(depth[i], variance_depth) * depth[i] ** 2
    return weights, costs, depth_costs


@kernel
def count_residuals(
    points: Array, samples: Array, residual_model: Array, cell_weights: Array
) -> Array:
    """Counts (7,) of a level's points.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (6,).
        cell_weights: (2, CELLS) of brightness and of depth.
    """
    counts = np.zeros(NUM_COUNTS)
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    for i in range(len(points)):
        cell = int(samples[i, SAMPLE_CELL])
        if samples[i, SAMPLE_OCCLUSION] == OCCLUDED:
            counts[NUM_OCCLUDED] += 1.0
            continue
        if cell < 0:
            continue
        brightness_weight, depth_weight = cell_weights[0, cell], cell_weights[1, cell]
        counts[IN_IMAGE] += 1.0
        counts[DISREGARDED] += max(brightness_weight, depth_weight) < MIN_STATIC_WEIGHT
        is_free_space = np.isnan(squared[i])
        if points[i, HAS_SHAPE] > 0 and (is_free_space or not np.isnan(squared_depth[i])):
            counts[WITH_DEPTH] += depth_weight
            counts[DEPTH_AGREES] += depth_weight * (squared_depth[i] < MAX_SQUARED_RESIDUAL)
        if points[i, HAS_TEXTURE] > 0:
            counts[WITH_BRIGHTNESS] += brightness_weight
            counts[BRIGHTNESS_AGREES] += brightness_weight * (squared[i] < MAX_SQUARED_RESIDUAL)
    return counts


@kernel
def negative_log_likelihood(points: Array, samples: Array, residual_model: Array) -> float:
    """Mean negative log-likelihood of the brightness plus that of the depth, up to a constant.

    By Student's t. Larger residuals than those of inliers cost no more, and so does a point in free
    space of the frame; an occluded one has no cost.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (6,).
    """
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    total = total_depth = count = count_depth = 0.0
    for i in range(len(points)):
        if samples[i, SAMPLE_CELL] < 0 or samples[i, SAMPLE_OCCLUSION] == OCCLUDED:
            continue
        is_free_space = np.isnan(squared[i])
        if points[i, HAS_SHAPE] > 0 and (is_free_space or not np.isnan(squared_depth[i])):
            total_depth += _log_cost(squared_depth[i])
            count_depth += 1.0
        if points[i, HAS_TEXTURE] > 0:
            total += _log_cost(squared[i])
            count += 1.0
    of_brightness = total / max(count, 1.0) + np.log(residual_model[SIGMA_BRIGHTNESS])
    of_depth = total_depth / max(count_depth, 1.0) + np.log(residual_model[SIGMA_DEPTH])
    return float(of_brightness + of_depth)


@inline_kernel
def _log_cost(squared: float) -> float:
    """Cost of a squared residual in variances; the largest one for NaN."""
    clipped = squared if squared < MAX_SQUARED_RESIDUAL else MAX_SQUARED_RESIDUAL
    return student_negative_log(clipped)


@kernel
def find_inliers(points: Array, samples: Array, residual_model: Array) -> NDArray[np.bool_]:
    """(N,) whether a point's brightness and depth samples agree with it.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (6,).
    """
    is_inlier = np.zeros(len(points), np.bool_)
    gain = residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(len(points)):
        brightness = samples[i, SAMPLE_BRIGHTNESS]
        depth = samples[i, SAMPLE_DEPTH_RESIDUAL]
        if np.isnan(brightness):
            continue
        residual = brightness_residual(brightness, points[i, POINT_BRIGHTNESS], gain)
        brightness_agrees = residual * residual < MAX_SQUARED_RESIDUAL * (
            variance + points[i, POINT_BRIGHTNESS_VARIANCE]
        )
        depth_agrees = np.isnan(depth) or depth * depth < MAX_SQUARED_RESIDUAL * variance_depth
        is_inlier[i] = (brightness_agrees or points[i, HAS_TEXTURE] == 0) and (
            depth_agrees or points[i, HAS_SHAPE] == 0
        )
    return is_inlier


@kernel
def weigh_regions(
    points: Array, samples: Array, residual_model: Array, base_weights: Array
) -> Array:
    """(2, CELLS) weights: the base weights, lowered where a cell fits worse than most cells do.

    Robust statistics handle single outliers. A moving object gives many samples that agree with
    each other, so it has to be detected as a region.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (6,).
        base_weights: (2, CELLS) of brightness and of depth.
    """
    means = _mean_cell_costs(points, samples, residual_model, base_weights)
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


@kernel
def _mean_cell_costs(
    points: Array, samples: Array, residual_model: Array, base_weights: Array
) -> Array:
    """(CELLS,) mean squared residual in variances, clipped; -1 for a cell with few samples.

    A point in free space of the frame has the largest cost; an occluded one has none.
    """
    sums, counts = np.zeros(NUM_CELLS), np.zeros(NUM_CELLS)
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    for i in range(len(points)):
        cell = int(samples[i, SAMPLE_CELL])
        if cell < 0 or samples[i, SAMPLE_OCCLUSION] == OCCLUDED:
            continue
        if np.isnan(squared[i]):
            sums[cell] += MAX_SQUARED_RESIDUAL
            counts[cell] += 1.0
            continue
        if points[i, HAS_TEXTURE] > 0 and base_weights[0, cell] > 0:
            sums[cell] += min(squared[i], MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
        if points[i, HAS_SHAPE] > 0 and not np.isnan(squared_depth[i]):
            sums[cell] += min(squared_depth[i], MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
    means = np.full(NUM_CELLS, -1.0)
    for cell in range(NUM_CELLS):
        if counts[cell] >= MIN_CELL_SAMPLES:
            means[cell] = sums[cell] / counts[cell]
    return means


@kernel
def _squared_residuals(points: Array, samples: Array, residual_model: Array) -> tuple[Array, Array]:
    """Squared residuals (N,) of brightness and of depth, in variances; NaN without a sample."""
    count = len(points)
    squared, squared_depth = np.empty(count), np.empty(count)
    brightness, depth = samples[:, SAMPLE_BRIGHTNESS], samples[:, SAMPLE_DEPTH_RESIDUAL]
    keyframe_brightness = points[:, POINT_BRIGHTNESS]
    point_variance = points[:, POINT_BRIGHTNESS_VARIANCE]
    gain = residual_model[GAIN]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(count):
        residual = brightness_residual(brightness[i], keyframe_brightness[i], gain)
        squared[i] = residual * residual / (variance + point_variance[i])
        squared_depth[i] = depth[i] * depth[i] / variance_depth
    return squared, squared_depth

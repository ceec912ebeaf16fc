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
from vo_service.odometry.direct.points import Points
from vo_service.odometry.direct.samples import Samples

# Upper bounds of the two sigmas, that of depth as a multiple of its noise.
MAX_SIGMAS = (MAX_SIGMA_RATIO * INITIAL_SIGMAS[0], MAX_SIGMA_RATIO * INITIAL_SIGMAS[1])
# Largest squared residual of an inlier, in variances; larger ones are clipped to it.
MAX_SQUARED_RESIDUAL = INLIER_GATE_SIGMAS**2


class ResidualModel(NamedTuple):
    """Model of the residuals of a frame, fitted with its motion.

    Attributes:
        gain: Of the frame's brightness relative to the keyframe's.
        sigma_brightness: Gray levels.
        sigma_depth: Of the inverse depth, 1/m.
        brightness_weight: Weight of brightness relative to depth.
        depth_noise: Of a pixel's inverse depth, 1/m.
        contrast: Standard deviation of the keyframe's brightness, gray levels.
    """

    gain: float
    sigma_brightness: float
    sigma_depth: float
    brightness_weight: float
    depth_noise: float
    contrast: float


class ResidualCounts(NamedTuple):
    """Numbers of points, and sums of the weights of samples.

    Attributes:
        in_image: Points in the image that are not occluded.
        disregarded: Points in moving regions.
        with_depth: Weight of the samples with depth.
        depth_agrees: Weight of those whose depth agrees within the gate.
        with_brightness: Weight of the samples with brightness.
        brightness_agrees: Weight of those whose brightness agrees within the gate.
        occluded: Occluded points.
    """

    in_image: float = 0.0
    disregarded: float = 0.0
    with_depth: float = 0.0
    depth_agrees: float = 0.0
    with_brightness: float = 0.0
    brightness_agrees: float = 0.0
    occluded: float = 0.0


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
def weigh_samples(points: Points, samples: Samples, cell_weights: Array) -> WeightedSamples:
    """Select the samples that count, with the weights of their cells.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        cell_weights: (2, CELLS) of brightness and of depth.
    """
    count = len(points.brightness)
    brightness, brightness_weight = np.zeros(count), np.zeros(count)
    depth, depth_weight = np.zeros(count), np.zeros(count)
    for i in range(count):
        cell = samples.cell[i]
        if not np.isnan(samples.brightness[i]) and points.has_texture[i]:
            brightness[i] = samples.brightness[i]
            brightness_weight[i] = cell_weights[0, cell]
        if not np.isnan(samples.depth_residual[i]) and points.has_shape[i]:
            depth[i] = samples.depth_residual[i]
            depth_weight[i] = cell_weights[1, cell]
    return WeightedSamples(brightness, brightness_weight, depth, depth_weight)


@kernel
def fit_residual_model(
    points: Points, weighted: WeightedSamples, residual_model: ResidualModel
) -> ResidualModel:
    """Return the residual model with gain and sigmas updated by one reweighting.

    Args:
        points: Of a keyframe level.
        weighted: The samples of these points in a frame.
        residual_model: The one before.
    """
    keyframe_brightness, point_variance = points.brightness, points.brightness_variance
    weights, costs, depth_costs = _student_costs(
        (keyframe_brightness, point_variance), weighted, residual_model
    )
    # Fields of a tuple cost time in a loop.
    brightness, brightness_weights, _, depth_weights = weighted
    n = chi = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    for i in range(len(points.brightness)):
        n += brightness_weights[i]
        chi += costs[i]
        w, expected = weights[i], keyframe_brightness[i]
        skk += w * expected * expected
        skc += w * expected * brightness[i]
        n_depth += depth_weights[i]
        chi_depth += depth_costs[i]
    gain, sigma, sigma_depth, brightness_weight, noise, contrast = residual_model
    if n >= MIN_SIGMA_SAMPLES:
        sigma = min(max(sigma * np.sqrt(chi / n), MIN_SIGMAS[0]), MAX_SIGMAS[0])
        if skk > 0.0:
            gain = min(max(skc / skk, GAIN_RANGE[0]), GAIN_RANGE[1])
    if n_depth >= MIN_SIGMA_SAMPLES:
        sigma_depth *= np.sqrt(chi_depth / n_depth)
        sigma_depth = min(max(sigma_depth, MIN_SIGMAS[1] * noise), MAX_SIGMAS[1] * noise)
    return ResidualModel(gain, sigma, sigma_depth, brightness_weight, noise, contrast)


@kernel
def _student_costs(
    of_points: tuple[Array, Array], weighted: WeightedSamples, residual_model: ResidualModel
) -> tuple[Array, Array, Array]:
    """Weights (N,) of the brightness samples, and weighted squared residuals (N,), see above.

    The second ones are of brightness, the third ones of depth, in variances. Points have (N,)
    brightness and its variance.
    """
    keyframe_brightness, point_variance = of_points
    count = len(keyframe_brightness)
    weights, costs, depth_costs = np.empty(count), np.empty(count), np.empty(count)
    brightness, brightness_weight, depth, depth_weight = weighted
    gain = residual_model.gain
    variance = residual_model.sigma_brightness**2
    variance_depth = residual_model.sigma_depth**2
    for i in range(count):
        residual = brightness_residual(brightness[i], keyframe_brightness[i], gain)
        weights[i] = brightness_weight[i] * student_weight(residual, variance + point_variance[i])
        costs[i] = weights[i] * residual * residual
        depth_costs[i] = depth_weight[i] * student_weight(depth[i], variance_depth) * depth[i] ** 2
    return weights, costs, depth_costs


@kernel
def count_residuals(
    points: Points, samples: Samples, residual_model: ResidualModel, cell_weights: Array
) -> ResidualCounts:
    """Count a level's points and samples.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        residual_model: Of the frame.
        cell_weights: (2, CELLS) of brightness and of depth.
    """
    in_image = disregarded = with_depth = depth_agrees = 0.0
    with_brightness = brightness_agrees = occluded = 0.0
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    for i in range(len(points.brightness)):
        cell = samples.cell[i]
        if samples.occlusion[i] > 0:
            occluded += 1.0
            continue
        if cell < 0:
            continue
        brightness_weight, depth_weight = cell_weights[0, cell], cell_weights[1, cell]
        in_image += 1.0
        disregarded += max(brightness_weight, depth_weight) < MIN_STATIC_WEIGHT
        is_free_space = np.isnan(squared[i])
        if points.has_shape[i] and (is_free_space or not np.isnan(squared_depth[i])):
            with_depth += depth_weight
            depth_agrees += depth_weight * (squared_depth[i] < MAX_SQUARED_RESIDUAL)
        if points.has_texture[i]:
            with_brightness += brightness_weight
            brightness_agrees += brightness_weight * (squared[i] < MAX_SQUARED_RESIDUAL)
    return ResidualCounts(
        in_image,
        disregarded,
        with_depth,
        depth_agrees,
        with_brightness,
        brightness_agrees,
        occluded,
    )


@kernel
def negative_log_likelihood(
    points: Points, samples: Samples, residual_model: ResidualModel
) -> float:
    """Mean negative log-likelihood of the brightness plus that of the depth, up to a constant.

    By Student's t. Larger residuals than those of inliers cost no more, and so does a point in free
    space of the frame; an occluded one has no cost.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        residual_model: Of the frame.
    """
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    total = total_depth = count = count_depth = 0.0
    for i in range(len(points.brightness)):
        if samples.cell[i] < 0 or samples.occlusion[i] > 0:
            continue
        is_free_space = np.isnan(squared[i])
        if points.has_shape[i] and (is_free_space or not np.isnan(squared_depth[i])):
            total_depth += _log_cost(squared_depth[i])
            count_depth += 1.0
        if points.has_texture[i]:
            total += _log_cost(squared[i])
            count += 1.0
    of_brightness = total / max(count, 1.0) + np.log(residual_model.sigma_brightness)
    of_depth = total_depth / max(count_depth, 1.0) + np.log(residual_model.sigma_depth)
    return float(of_brightness + of_depth)


@inline_kernel
def _log_cost(squared: float) -> float:
    """Cost of a squared residual in variances; the largest one for NaN."""
    clipped = squared if squared < MAX_SQUARED_RESIDUAL else MAX_SQUARED_RESIDUAL
    return student_negative_log(clipped)


@kernel
def find_inliers(
    points: Points, samples: Samples, residual_model: ResidualModel
) -> NDArray[np.bool_]:
    """(N,) whether a point's brightness and depth samples agree with it.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        residual_model: Of the frame.
    """
    is_inlier = np.zeros(len(points.brightness), np.bool_)
    gain = residual_model.gain
    variance = residual_model.sigma_brightness**2
    variance_depth = residual_model.sigma_depth**2
    for i in range(len(points.brightness)):
        brightness = samples.brightness[i]
        depth = samples.depth_residual[i]
        if np.isnan(brightness):
            continue
        residual = brightness_residual(brightness, points.brightness[i], gain)
        brightness_agrees = residual * residual < MAX_SQUARED_RESIDUAL * (
            variance + points.brightness_variance[i]
        )
        depth_agrees = np.isnan(depth) or depth * depth < MAX_SQUARED_RESIDUAL * variance_depth
        is_inlier[i] = (brightness_agrees or not points.has_texture[i]) and (
            depth_agrees or not points.has_shape[i]
        )
    return is_inlier


@kernel
def weigh_regions(
    points: Points, samples: Samples, residual_model: ResidualModel, base_weights: Array
) -> Array:
    """(2, CELLS) weights: the base weights, lowered where a cell fits worse than most cells do.

    Robust statistics handle single outliers. A moving object gives many samples that agree with
    each other, so it has to be detected as a region.

    Args:
        points: Of a keyframe level.
        samples: Of these points in a frame.
        residual_model: Of the frame.
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
    points: Points, samples: Samples, residual_model: ResidualModel, base_weights: Array
) -> Array:
    """(CELLS,) mean squared residual in variances, clipped; -1 for a cell with few samples.

    A point in free space of the frame has the largest cost; an occluded one has none.
    """
    sums, counts = np.zeros(NUM_CELLS), np.zeros(NUM_CELLS)
    squared, squared_depth = _squared_residuals(points, samples, residual_model)
    for i in range(len(points.brightness)):
        cell = samples.cell[i]
        if cell < 0 or samples.occlusion[i] > 0:
            continue
        if np.isnan(squared[i]):
            sums[cell] += MAX_SQUARED_RESIDUAL
            counts[cell] += 1.0
            continue
        if points.has_texture[i] and base_weights[0, cell] > 0:
            sums[cell] += min(squared[i], MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
        if points.has_shape[i] and not np.isnan(squared_depth[i]):
            sums[cell] += min(squared_depth[i], MAX_SQUARED_RESIDUAL)
            counts[cell] += 1.0
    means = np.full(NUM_CELLS, -1.0)
    for cell in range(NUM_CELLS):
        if counts[cell] >= MIN_CELL_SAMPLES:
            means[cell] = sums[cell] / counts[cell]
    return means


@kernel
def _squared_residuals(
    points: Points, samples: Samples, residual_model: ResidualModel
) -> tuple[Array, Array]:
    """Squared residuals (N,) of brightness and of depth, in variances; NaN without a sample."""
    keyframe_brightness, point_variance = points.brightness, points.brightness_variance
    brightness, depth = samples.brightness, samples.depth_residual
    count = len(brightness)
    squared, squared_depth = np.empty(count), np.empty(count)
    gain = residual_model.gain
    variance = residual_model.sigma_brightness**2
    variance_depth = residual_model.sigma_depth**2
    for i in range(count):
        residual = brightness_residual(brightness[i], keyframe_brightness[i], gain)
        squared[i] = residual * residual / (variance + point_variance[i])
        squared_depth[i] = depth[i] * depth[i] / variance_depth
    return squared, squared_depth

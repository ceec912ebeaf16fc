"""Samples of a keyframe's points in a frame, their residuals, and the weights of image regions.

Each row is sampled at its own time. Brightness and depth residuals follow Student's t, as many are
outliers. Their sigmas are estimated with the motion, and so are gain and offset of the brightness:
Kerl, Sturm and Cremers, "Robust Odometry Estimation for RGB-D Cameras" (ICRA 2013); Klose, Heise
and Knoll, "Efficient Compositional Approaches for Real-Time Robust Direct Visual Odometry" (IROS
2013).
"""

from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import GAIN_RANGE, NUM_CELLS, LevelImages, cell_index
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
)
from vo_service.odometry.direct.motion import project_rolling_shutter
from vo_service.odometry.direct.parameters import (
    DEGREES_OF_FREEDOM,
    INITIAL_SIGMAS,
    INLIER_GATE_SIGMAS,
    MAX_REGION_COST_RATIO,
    MAX_SAME_SURFACE_PER_M,
    MAX_SIGMA_RATIO,
    MAX_SURFACE_STEP_PER_M,
    MIN_CELL_SAMPLES,
    MIN_CURVATURE_RATIO,
    MIN_DEPTH_M,
    MIN_SIGMA_SAMPLES,
    MIN_STATIC_WEIGHT,
    SENSOR_SIGMAS,
)

# The image is divided into this many bands of rows; all rows of a band get the same time.
NUM_ROW_BANDS = 16
# Columns of a sample: brightness; 1/z of the surface minus that of the point (1/m, as seen from the
# keyframe); the cell; the bands of the color and of the depth image; the pixel in the whole color
# image; NaN or -1 where there is none. Then the occlusion: 1 if another surface is in front of the
# point, -1 if the point is in free space. Such a sample has neither brightness nor depth.
(
    SAMPLE_BRIGHTNESS,
    SAMPLE_DEPTH_RESIDUAL,
    SAMPLE_CELL,
    SAMPLE_COLOR_BAND,
    SAMPLE_DEPTH_BAND,
    SAMPLE_U,
    SAMPLE_V,
    SAMPLE_OCCLUSION,
) = range(8)
NUM_SAMPLE_COLUMNS = 8
OCCLUDED = 1.0


@kernel
def empty_samples(count: int) -> Array:
    """(N, COLUMNS) for the samples of N points; columns are contiguous, see `select_points`."""
    return np.empty((NUM_SAMPLE_COLUMNS, count)).T


@kernel
def warp_and_sample(
    points: Array, images: LevelImages, T_camera_keyframe: Array, motion: Array, samples: Array
) -> None:
    """Fill in the samples of points.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        images: The frame at that level.
        T_camera_keyframe: 4x4.
        motion: (9,) of the camera in its own axes at the frame's stamp, see `motion`.
        samples: (N, COLUMNS), out.
    """
    u_color, v_color, u_depth, v_depth, inverse_z = project_rolling_shutter(
        points, images, T_camera_keyframe, motion
    )
    scale = images.intrinsics[0] / images.depth_intrinsics[0]
    brightness = _sample_brightness(images.gray, u_color, v_color, scale)
    surface = _sample_inverse_depth(images.inverse_depth, u_depth, v_depth)
    pixels = u_color, v_color, v_depth
    _fill_samples(pixels, inverse_z, brightness, surface, points, images.inverse_depth, samples)
    if images.vignetting != 0.0:
        _correct_vignetting(images.vignetting, points, images.depth_intrinsics, samples)


@kernel
def _sample_brightness(gray: NDArray[np.uint8], u: Array, v: Array, scale: float) -> Array:
    """(N,) bilinear brightness at pixels (N,) of the whole image; -1 outside of the level's image.

    Args:
        gray: (h, w) of the level.
        u: (N,) columns in the whole image.
        v: (N,) rows in the whole image.
        scale: Size of the level's image relative to the whole one.
    """
    height, width = gray.shape
    brightness = np.full(len(u), -1.0)
    for n in range(len(u)):
        x, y = (u[n] + 0.5) * scale - 0.5, (v[n] + 0.5) * scale - 0.5
        if 0.0 <= x < width - 1 and 0.0 <= y < height - 1:
            # Unsigned, so that no index is tested for counting from the end.
            column, row = np.uint32(x), np.uint32(y)
            right, down = x - column, y - row
            a, b = float(gray[row, column]), float(gray[row, column + 1])
            c, d = float(gray[row + 1, column]), float(gray[row + 1, column + 1])
            above, below = a + right * (b - a), c + right * (d - c)
            brightness[n] = above + down * (below - above)
    return brightness


@kernel
def _sample_inverse_depth(inverse_depth: NDArray[np.float32], u: Array, v: Array) -> Array:
    """(N,) bilinear 1/z, 1/m, at pixels (N,); 0 outside, at edges, and next to a missing reading.

    Args:
        inverse_depth: (H, W), 1/m; 0 = no reading.
        u: (N,) columns.
        v: (N,) rows.
    """
    height, width = inverse_depth.shape
    surface, flat = np.zeros(len(u)), inverse_depth.ravel()
    for n in range(len(u)):
        if not (0.0 <= u[n] < width - 1 and 0.0 <= v[n] < height - 1):
            continue
        column, row = np.uint32(u[n]), np.uint32(v[n])
        k = np.uint32(row * width + column)
        a, b = float(flat[k]), float(flat[k + 1])
        c, d = float(flat[k + width]), float(flat[k + width + 1])
        lowest = min(min(a, b), min(c, d))
        if lowest <= 0.0 or max(max(a, b), max(c, d)) - lowest > MAX_SURFACE_STEP_PER_M:
            continue
        right, down = u[n] - column, v[n] - row
        above, below = a + right * (b - a), c + right * (d - c)
        surface[n] = above + down * (below - above)
    return surface


@kernel
def _fill_samples(
    pixels: tuple[Array, Array, Array],
    inverse_z: Array,
    brightness: Array,
    surface: Array,
    points: Array,
    inverse_depth: NDArray[np.float32],
    samples: Array,
) -> None:
    """Fill in the samples. Without branches, so that the compiler vectorizes the loop.

    Args:
        pixels: (N,) column and row in the color image, row in the depth image.
        inverse_z: (N,) 1/z of the points, 1/m.
        brightness: (N,) of the frame; -1 outside.
        surface: (N,) 1/z of the frame, 1/m; 0 without a reading.
        points: (N, COLUMNS) of a keyframe level.
        inverse_depth: (H, W) image of the frame, for its size.
        samples: (N, COLUMNS), out.
    """
    height, width = inverse_depth.shape
    per_width, per_height = 1.0 / width, 1.0 / height
    u_color, v_color, v_depth = pixels
    for n in range(len(samples)):
        u, v, w_point, w = u_color[n], v_color[n], inverse_z[n], surface[n]
        in_image = (brightness[n] >= 0.0) & (w_point > 0.0) & (w_point <= 1.0 / MIN_DEPTH_M)
        difference = w - w_point
        has_surface = in_image & (w > 0.0)
        is_other_surface = has_surface & (abs(difference) > MAX_SAME_SURFACE_PER_M)
        is_same_surface = has_surface & (not is_other_surface)
        is_visible = in_image & (not is_other_surface)
        samples[n, SAMPLE_U] = u if in_image else -1.0
        samples[n, SAMPLE_V] = v if in_image else -1.0
        samples[n, SAMPLE_CELL] = cell_index(u * per_width, v * per_height) if in_image else -1.0
        samples[n, SAMPLE_OCCLUSION] = np.sign(difference) if is_other_surface else 0.0
        residual = difference / (w_point * points[n, 2]) ** 2
        samples[n, SAMPLE_DEPTH_RESIDUAL] = residual if is_same_surface else np.nan
        depth_band = _row_band(v_depth[n] * per_height)
        samples[n, SAMPLE_DEPTH_BAND] = depth_band if is_same_surface else -1.0
        samples[n, SAMPLE_BRIGHTNESS] = brightness[n] if is_visible else np.nan
        samples[n, SAMPLE_COLOR_BAND] = _row_band(v * per_height) if is_visible else -1.0


@kernel
def _correct_vignetting(
    vignetting: float, points: Array, intrinsics: Array, samples: Array
) -> None:
    """Correct the brightness of samples (N, COLUMNS) to that at the keyframe's pixel."""
    for n in range(len(points)):
        u, v = samples[n, SAMPLE_U], samples[n, SAMPLE_V]
        change = squared_radius_change(u, v, intrinsics, points[n])
        samples[n, SAMPLE_BRIGHTNESS] *= 1.0 + vignetting * change


@inline_kernel
def squared_radius_change(u: float, v: float, intrinsics: Array, point: Array) -> float:
    """Change of a point's squared radius from its keyframe to a pixel.

    The radius is the tangent of the angle to the optical axis.

    Args:
        u: Pixel in the whole image.
        v: See u.
        intrinsics: (4,) of the whole image.
        point: (COLUMNS,) of a keyframe.
    """
    x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
    before = (point[0] * point[0] + point[1] * point[1]) / (point[2] * point[2])
    return float(x * x + y * y - before)


@inline_kernel
def _row_band(v_share: float) -> int:
    """Index of the band that a row belongs to, given as a share of the image's height."""
    return min(max(int(v_share * NUM_ROW_BANDS), 0), NUM_ROW_BANDS - 1)


# The residual model: gain and offset of the keyframe's brightness, the two sigmas, and the weight
# of brightness relative to depth.
GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH, WEIGHT_BRIGHTNESS = range(5)
RESIDUAL_MODEL_SIZE = 5
# Upper bounds of the two sigmas.
MAX_SIGMAS = (MAX_SIGMA_RATIO * INITIAL_SIGMAS[0], MAX_SIGMA_RATIO * INITIAL_SIGMAS[1])
# Below this share of its first term the scatter of the brightness is rounding error.
_ROUNDING = 1e-9
# The counts: points in the image that are not occluded; points in moving regions; by weight,
# samples with depth, and those whose depth agrees within the gate; the same of brightness; the
# robust cost of all; occluded points.
(
    IN_IMAGE,
    DISREGARDED,
    WITH_DEPTH,
    DEPTH_AGREES,
    WITH_BRIGHTNESS,
    BRIGHTNESS_AGREES,
    COST,
    NUM_OCCLUDED,
) = range(8)
# Largest squared residual of an inlier, in variances; larger ones are clipped to it.
MAX_SQUARED_RESIDUAL = INLIER_GATE_SIGMAS**2
# Cost of a point whose brightness and depth are both wrong.
MAX_POINT_COST = 2.0 * log(1.0 + MAX_SQUARED_RESIDUAL / DEGREES_OF_FREEDOM)


@inline_kernel
def residual_variances(residual_model: Array) -> tuple[float, float]:
    """Variances of brightness and of depth by the residual model (5,)."""
    return residual_model[SIGMA_BRIGHTNESS] ** 2, residual_model[SIGMA_DEPTH] ** 2


@inline_kernel
def student_weight(residual: float, variance: float) -> float:
    """Weight of a residual in the fit: that of Student's t over its variance."""
    # A division takes as long as all the rest.
    return (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM * variance + residual * residual)


@inline_kernel
def student_curvature(residual: float, variance: float) -> float:
    """Second derivative of Student's t over its weight, bounded."""
    squared = residual * residual / variance
    return max((DEGREES_OF_FREEDOM - squared) / (DEGREES_OF_FREEDOM + squared), MIN_CURVATURE_RATIO)


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
def fit_affine_brightness(points: Array, weighted: WeightedSamples, residual_model: Array) -> None:
    """Update gain, offset and sigmas of the residual model (5,) in place, by one reweighting.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        weighted: The samples of these points in a frame.
        residual_model: (5,), in and out.
    """
    weights, costs, depth_costs = _student_costs(points, weighted, residual_model)
    # Fields of a tuple cost time in a loop.
    brightness, brightness_weight, _, depth_weight = weighted
    n = chi = s = sk = sc = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    for i in range(len(points)):
        n += brightness_weight[i]
        chi += costs[i]
        w, keyframe_brightness = weights[i], points[i, POINT_BRIGHTNESS]
        s += w
        sk += w * keyframe_brightness
        sc += w * brightness[i]
        skk += w * keyframe_brightness * keyframe_brightness
        skc += w * keyframe_brightness * brightness[i]
        n_depth += depth_weight[i]
        chi_depth += depth_costs[i]
    if n >= MIN_SIGMA_SAMPLES:
        sigma = residual_model[SIGMA_BRIGHTNESS] * np.sqrt(chi / n)
        residual_model[SIGMA_BRIGHTNESS] = min(max(sigma, SENSOR_SIGMAS[0]), MAX_SIGMAS[0])
        scatter = skk - sk * sk / s
        if scatter > _ROUNDING * skk:
            residual_model[GAIN] = min(
                max((skc - sk * sc / s) / scatter, GAIN_RANGE[0]), GAIN_RANGE[1]
            )
        residual_model[OFFSET] = (sc - residual_model[GAIN] * sk) / s
    if n_depth >= MIN_SIGMA_SAMPLES:
        sigma = residual_model[SIGMA_DEPTH] * np.sqrt(chi_depth / n_depth)
        residual_model[SIGMA_DEPTH] = min(max(sigma, SENSOR_SIGMAS[1]), MAX_SIGMAS[1])


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
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(count):
        sample_variance = variance + point_variance[i]
        residual = brightness[i] - gain * keyframe_brightness[i] - offset
        squared = residual * residual / sample_variance
        w = brightness_weight[i] * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
        costs[i] = w * squared
        weights[i] = w / sample_variance
        squared = depth[i] * depth[i] / variance_depth
        depth_costs[i] = (
            depth_weight[i] * squared * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
        )
    return weights, costs, depth_costs


@kernel
def count_residuals(
    points: Array, samples: Array, residual_model: Array, cell_weights: Array
) -> Array:
    """Counts (8,) of a level's points.

    A point in free space of the frame has the largest cost; an occluded one has none.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (5,).
        cell_weights: (2, CELLS) of brightness and of depth.
    """
    counts = np.zeros(8)
    variance, variance_depth = residual_variances(residual_model)
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
    """(N,) whether a point's brightness and depth samples agree with it.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        residual_model: (5,).
    """
    is_inlier = np.zeros(len(points), np.bool_)
    variance, variance_depth = residual_variances(residual_model)
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
        residual_model: (5,).
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
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(count):
        residual = brightness[i] - gain * keyframe_brightness[i] - offset
        squared[i] = residual * residual / (variance + point_variance[i])
        squared_depth[i] = depth[i] * depth[i] / variance_depth
    return squared, squared_depth

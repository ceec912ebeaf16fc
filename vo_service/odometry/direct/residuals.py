"""Samples of a keyframe's points in a frame, their residuals, and the weights of image regions.

Each row is sampled at its own time. Brightness and depth residuals follow Student's t, as many are
outliers. Their sigmas are estimated with the motion, and so are gain and offset of the brightness:
Kerl, Sturm and Cremers, "Robust Odometry Estimation for RGB-D Cameras" (ICRA 2013); Klose, Heise
and Knoll, "Efficient Compositional Approaches for Real-Time Robust Direct Visual Odometry" (IROS
2013).
"""

from math import log

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
    # Fields of a tuple cost time in a loop.
    gray, intrinsics, inverse_depth, depth_intrinsics, _, _, vignetting = images
    height, width = inverse_depth.shape
    per_width, per_height = 1.0 / width, 1.0 / height
    scale = intrinsics[0] / depth_intrinsics[0]
    u_color, v_color, u_depth, v_depth, inverse_z = project_rolling_shutter(
        points, images, T_camera_keyframe, motion
    )
    for n in range(len(points)):
        sample = samples[n]
        _clear_sample(sample)
        u, v, w_point = u_color[n], v_color[n], inverse_z[n]
        if not 0.0 < w_point <= 1.0 / MIN_DEPTH_M:
            continue
        brightness = _interpolate_brightness(gray, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5)
        if brightness < 0.0:
            continue
        sample[SAMPLE_U], sample[SAMPLE_V] = u, v
        sample[SAMPLE_CELL] = cell_index(u * per_width, v * per_height)
        w = _interpolate_inverse_depth(inverse_depth, u_depth[n], v_depth[n])
        difference = w - w_point
        if w > 0.0 and abs(difference) > MAX_SAME_SURFACE_PER_M:
            sample[SAMPLE_OCCLUSION] = np.sign(difference)
            continue
        if w > 0.0:
            sample[SAMPLE_DEPTH_RESIDUAL] = difference / (w_point * points[n, 2]) ** 2
            sample[SAMPLE_DEPTH_BAND] = _row_band(v_depth[n] * per_height)
        if vignetting != 0.0:
            brightness *= 1.0 + vignetting * squared_radius_change(
                u, v, depth_intrinsics, points[n]
            )
        sample[SAMPLE_BRIGHTNESS] = brightness
        sample[SAMPLE_COLOR_BAND] = _row_band(v * per_height)


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
def _clear_sample(sample: Array) -> None:
    """Set all columns to their values for no sample."""
    sample[SAMPLE_BRIGHTNESS] = sample[SAMPLE_DEPTH_RESIDUAL] = np.nan
    sample[SAMPLE_CELL] = sample[SAMPLE_COLOR_BAND] = sample[SAMPLE_DEPTH_BAND] = -1.0
    sample[SAMPLE_U] = sample[SAMPLE_V] = -1.0
    sample[SAMPLE_OCCLUSION] = 0.0


@inline_kernel
def _row_band(v_share: float) -> int:
    """Index of the band that a row belongs to, given as a share of the image's height."""
    return min(max(int(v_share * NUM_ROW_BANDS), 0), NUM_ROW_BANDS - 1)


@inline_kernel
def _interpolate_brightness(gray: NDArray[np.uint8], u: float, v: float) -> float:
    """Bilinear brightness; -1 outside of the image."""
    height, width = gray.shape
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return -1.0
    column, row = int(u), int(v)
    right, down = u - column, v - row
    a, b = float(gray[row, column]), float(gray[row, column + 1])
    c, d = float(gray[row + 1, column]), float(gray[row + 1, column + 1])
    above, below = a + right * (b - a), c + right * (d - c)
    return above + down * (below - above)


@inline_kernel
def _interpolate_inverse_depth(inverse_depth: NDArray[np.float32], u: float, v: float) -> float:
    """Bilinear 1/z, 1/m; 0 outside, at edges, and next to a pixel without reading."""
    height, width = inverse_depth.shape
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return 0.0
    column, row = int(u), int(v)
    a, b = float(inverse_depth[row, column]), float(inverse_depth[row, column + 1])
    c, d = float(inverse_depth[row + 1, column]), float(inverse_depth[row + 1, column + 1])
    lowest = min(min(a, b), min(c, d))
    if lowest <= 0.0 or max(max(a, b), max(c, d)) - lowest > MAX_SURFACE_STEP_PER_M:
        return 0.0
    right, down = u - column, v - row
    above, below = a + right * (b - a), c + right * (d - c)
    return above + down * (below - above)


# The residual model: gain and offset of the keyframe's brightness, the two sigmas, and the weight
# of brightness relative to depth.
GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH, WEIGHT_BRIGHTNESS = range(5)
RESIDUAL_MODEL_SIZE = 5
# Upper bounds of the two sigmas.
MAX_SIGMAS = (MAX_SIGMA_RATIO * INITIAL_SIGMAS[0], MAX_SIGMA_RATIO * INITIAL_SIGMAS[1])
# Rows of the cell weights.
_BRIGHTNESS_ROW, _DEPTH_ROW = 0, 1
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


@kernel
def fit_affine_brightness(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array
) -> None:
    """Update gain, offset and sigmas of the residual model (5,) in place, by one reweighting.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        samples: (N, COLUMNS) of these points in a frame.
        cell_weights: (2, CELLS) of brightness and of depth.
        residual_model: (5,), in and out.
    """
    n = chi = s = sk = sc = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = residual_variances(residual_model)
    for i in range(len(points)):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            cell_weight = cell_weights[_BRIGHTNESS_ROW, int(samples[i, SAMPLE_CELL])]
            keyframe_brightness = points[i, POINT_BRIGHTNESS]
            sample_variance = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            squared = (brightness - gain * keyframe_brightness - offset) ** 2 / sample_variance
            w = cell_weight * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
            n += cell_weight
            chi += w * squared
            w /= sample_variance
            s += w
            sk += w * keyframe_brightness
            sc += w * brightness
            skk += w * keyframe_brightness * keyframe_brightness
            skc += w * keyframe_brightness * brightness
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            cell_weight = cell_weights[_DEPTH_ROW, int(samples[i, SAMPLE_CELL])]
            squared = depth * depth / variance_depth
            n_depth += cell_weight
            chi_depth += (
                cell_weight * squared * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
            )
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
    variance, variance_depth = residual_variances(residual_model)
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
    return means

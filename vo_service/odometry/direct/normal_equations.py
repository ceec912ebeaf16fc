"""Normal equations of one step of the alignment, from a keyframe's points and a frame's samples.

Brightness and depth residuals follow Student's t, as many are outliers. Their sigmas are estimated
with the motion, and so are gain and offset of the brightness. Kerl,
Sturm and Cremers, "Robust Odometry Estimation for RGB-D Cameras" (ICRA 2013); Klose, Heise and
Knoll, "Efficient Compositional Approaches for Real-Time Robust Direct Visual Odometry" (IROS 2013).
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import GAIN_RANGE
from vo_service.odometry.direct.keyframe_points import (
    HAS_SHAPE,
    HAS_TEXTURE,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_DEPTH_GRADIENT,
)
from vo_service.odometry.direct.parameters import (
    BRIGHTNESS_WEIGHT,
    DEGREES_OF_FREEDOM,
    INITIAL_SIGMAS,
    MAX_SIGMA_RATIO,
    MIN_SIGMA_SAMPLES,
    SENSOR_SIGMAS,
)
from vo_service.odometry.direct.rolling_shutter import NUM_UNKNOWNS
from vo_service.odometry.direct.warping import (
    NUM_ROW_BANDS,
    SAMPLE_BRIGHTNESS,
    SAMPLE_CELL,
    SAMPLE_COLOR_BAND,
    SAMPLE_DEPTH_BAND,
    SAMPLE_DEPTH_RESIDUAL,
)

# The residual model: gain and offset of the keyframe's brightness, then the two sigmas.
GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH = 0, 1, 2, 3
# Indices of a symmetric 6x6 matrix's elements in its upper triangle, row by row.
UPPER_TRIANGLE = np.empty((6, 6), np.intp)
UPPER_TRIANGLE[np.triu_indices(6)] = UPPER_TRIANGLE.T[np.triu_indices(6)] = np.arange(21)
# Upper bounds of the two sigmas.
MAX_SIGMAS = (MAX_SIGMA_RATIO * INITIAL_SIGMAS[0], MAX_SIGMA_RATIO * INITIAL_SIGMAS[1])
# Rows of the cell weights.
_BRIGHTNESS_ROW, _DEPTH_ROW = 0, 1


@kernel
def fit_affine_brightness(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array
) -> None:
    """Update gain, offset and sigmas of the residual model (4,) in place, by one reweighting."""
    n = chi = s = sk = sc = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
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
        if scatter > 1e-9 * skk:
            residual_model[GAIN] = min(
                max((skc - sk * sc / s) / scatter, GAIN_RANGE[0]), GAIN_RANGE[1]
            )
        residual_model[OFFSET] = (sc - residual_model[GAIN] * sk) / s
    if n_depth >= MIN_SIGMA_SAMPLES:
        sigma = residual_model[SIGMA_DEPTH] * np.sqrt(chi_depth / n_depth)
        residual_model[SIGMA_DEPTH] = min(max(sigma, SENSOR_SIGMAS[1]), MAX_SIGMAS[1])


@kernel
def accumulate(points: Array, samples: Array, cell_weights: Array, residual_model: Array) -> Array:
    """(2 BANDS, 27) sums over the bands of the color image, then over those of the depth image.

    With r = J d, d a small motion of the keyframe's points as a twist (translation m, rotation rad)
    in the keyframe's axes: the upper triangle of sum w J^T J, row by row, then sum w J^T r. All
    rows of a band get the same time, which saves sums and loses little.
    """
    sums = np.zeros((2 * NUM_ROW_BANDS, 27))
    J = np.empty(6)
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness, depth = samples[i, SAMPLE_BRIGHTNESS], samples[i, SAMPLE_DEPTH_RESIDUAL]
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, POINT_BRIGHTNESS] - offset
            sample_variance = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + residual * residual / sample_variance)
                / sample_variance
            )
            w *= BRIGHTNESS_WEIGHT * cell_weights[_BRIGHTNESS_ROW, int(samples[i, SAMPLE_CELL])]
            fill_jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain, J)
            _add_to_sums(sums[int(samples[i, SAMPLE_COLOR_BAND])], J, w, residual)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + depth * depth / variance_depth)
                / variance_depth
            )
            w *= cell_weights[_DEPTH_ROW, int(samples[i, SAMPLE_CELL])]
            fill_jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0, J)
            _add_to_sums(sums[NUM_ROW_BANDS + int(samples[i, SAMPLE_DEPTH_BAND])], J, w, depth)
    return sums


@inline_kernel
def fill_jacobian(point: Array, gradient_column: int, scale: float, J: Array) -> None:
    """Fill J (6,): scale times (p, x cross p) of the derivative p by the point's position x."""
    x, y, z = point[0], point[1], point[2]
    px, py, pz = (
        scale * point[gradient_column],
        scale * point[gradient_column + 1],
        scale * point[gradient_column + 2],
    )
    J[0], J[1], J[2] = px, py, pz
    J[3], J[4], J[5] = y * pz - z * py, z * px - x * pz, x * py - y * px


@inline_kernel
def _add_to_sums(sums: Array, J: Array, w: float, residual: float) -> None:
    """Add the upper triangle of w J J^T, row by row, then w J r."""
    k = 0
    for i in range(6):
        weighted = w * J[i]
        for j in range(i, 6):
            sums[k] += weighted * J[j]
            k += 1
        sums[21 + i] += weighted * residual


@kernel
def band_times(readout_s: float, skew_s: float) -> Array:
    """(2 BANDS,) time of each band's middle row after the frame's stamp, s."""
    times = np.empty(2 * NUM_ROW_BANDS)
    for n in range(NUM_ROW_BANDS):
        times[n] = ((n + 0.5) / NUM_ROW_BANDS - 0.5) * readout_s
        times[NUM_ROW_BANDS + n] = times[n] + skew_s
    return times


@kernel
def expand_rolling_shutter(sums: Array, readout_s: float, skew_s: float) -> tuple[Array, Array]:
    """Information (15, 15) and vector (15,) of the pose and of the motion (9,).

    With r = J (d + tau e + tau^2 f / 2), e and f small changes of the velocity and of the angular
    acceleration (this with J's rotation only), and tau the time of the sample: J' = [J, tau J,
    tau^2 J / 2], and sum w J'^T J' and sum w J'^T r.
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    times = band_times(readout_s, skew_s)
    band_information = np.empty((6, 6))
    for n in range(2 * NUM_ROW_BANDS):
        tau = times[n]
        half = 0.5 * tau * tau
        k = 0
        for i in range(6):
            for j in range(i, 6):
                band_information[i, j] = band_information[j, i] = sums[n, k]
                k += 1
        for i in range(6):
            for j in range(6):
                value = band_information[i, j]
                H[i, j] += value
                H[i, 6 + j] += tau * value
                H[6 + i, 6 + j] += tau * tau * value
                if j >= 3:
                    H[i, 9 + j] += half * value
                    H[6 + i, 9 + j] += tau * half * value
                    if i >= 3:
                        H[9 + i, 9 + j] += half * half * value
            r = sums[n, 21 + i]
            g[i] += r
            g[6 + i] += tau * r
            if i >= 3:
                g[9 + i] += half * r
    for i in range(NUM_UNKNOWNS):
        for j in range(i):
            H[i, j] = H[j, i]
    return H, g

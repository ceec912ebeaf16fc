"""The weighted least squares of one step, from a keyframe's points and what a frame shows of them.

Brightness and depth both follow Student's t: many readings are of something else. Their spread is
found with the motion, and so are a gain and an offset between the two images' brightness. Kerl,
Sturm and Cremers, "Robust Odometry Estimation for RGB-D Cameras" (ICRA 2013); Klose, Heise and
Knoll, "Efficient Compositional Approaches for Real-Time Robust Direct Visual Odometry" (IROS 2013).
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct import warping as reading_columns
from vo_service.odometry.direct.derived_parameters import GAIN_RANGE, MAX_SIGMAS
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
    HALF,
    MIN_POINTS,
    SENSOR_SIGMAS,
)
from vo_service.odometry.direct.rolling_shutter import NUM_UNKNOWNS
from vo_service.odometry.direct.warping import NUM_ROW_BANDS

# The fit: what a keyframe's brightness is multiplied by and what is added, then the two spreads.
GAIN, OFFSET, SIGMA_BRIGHTNESS, SIGMA_DEPTH = 0, 1, 2, 3
# Where the elements of a symmetric 6x6 matrix are in its upper triangle, row by row.
UPPER_TRIANGLE = np.empty((6, 6), np.intp)
UPPER_TRIANGLE[np.triu_indices(6)] = UPPER_TRIANGLE.T[np.triu_indices(6)] = np.arange(21)
# Rows of the cells' weights.
_BRIGHTNESS_ROW, _DEPTH_ROW = 0, 1
_BRIGHTNESS, _DEPTH = reading_columns.SAMPLE_BRIGHTNESS, reading_columns.SAMPLE_DEPTH_RESIDUAL
_CELL = reading_columns.SAMPLE_CELL
_COLOR_BAND, _DEPTH_BAND = reading_columns.SAMPLE_COLOR_BAND, reading_columns.SAMPLE_DEPTH_BAND


@kernel
def fit_affine_brightness(
    points: Array, samples: Array, cell_weights: Array, residual_model: Array
) -> None:
    """One sweep towards gain, offset and spreads, in place, with weights by what they were."""
    n = chi = s = sk = sc = skk = skc = 0.0
    n_depth = chi_depth = 0.0
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness, depth = samples[i, _BRIGHTNESS], samples[i, _DEPTH]
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            cell_weight = cell_weights[_BRIGHTNESS_ROW, int(samples[i, _CELL])]
            mine = points[i, POINT_BRIGHTNESS]
            of_this = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            squared = (brightness - gain * mine - offset) ** 2 / of_this
            w = cell_weight * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
            n += cell_weight
            chi += w * squared
            w /= of_this
            s += w
            sk += w * mine
            sc += w * brightness
            skk += w * mine * mine
            skc += w * mine * brightness
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            cell_weight = cell_weights[_DEPTH_ROW, int(samples[i, _CELL])]
            squared = depth * depth / variance_depth
            n_depth += cell_weight
            chi_depth += (
                cell_weight * squared * (DEGREES_OF_FREEDOM + 1.0) / (DEGREES_OF_FREEDOM + squared)
            )
    if n >= HALF * MIN_POINTS:
        sigma = residual_model[SIGMA_BRIGHTNESS] * np.sqrt(chi / n)
        residual_model[SIGMA_BRIGHTNESS] = min(max(sigma, SENSOR_SIGMAS[0]), MAX_SIGMAS[0])
        spread = skk - sk * sk / s
        if spread > 1e-9 * skk:
            residual_model[GAIN] = min(
                max((skc - sk * sc / s) / spread, GAIN_RANGE[0]), GAIN_RANGE[1]
            )
        residual_model[OFFSET] = (sc - residual_model[GAIN] * sk) / s
    if n_depth >= HALF * MIN_POINTS:
        sigma = residual_model[SIGMA_DEPTH] * np.sqrt(chi_depth / n_depth)
        residual_model[SIGMA_DEPTH] = min(max(sigma, SENSOR_SIGMAS[1]), MAX_SIGMAS[1])


@kernel
def accumulate(points: Array, samples: Array, cell_weights: Array, residual_model: Array) -> Array:
    """(2 BANDS, 27) sums over the bands of the color image, then over those of the depth image.

    With r = J d, d a small motion of the keyframe's points as a twist (translation m, rotation rad)
    in the keyframe's axes: the upper triangle of sum w J^T J, row by row, then sum w J^T r. Rows of
    a band are taken at one time: so little is lost, and so much less is summed.
    """
    sums = np.zeros((2 * NUM_ROW_BANDS, 27))
    J = np.empty(6)
    gain, offset = residual_model[GAIN], residual_model[OFFSET]
    variance, variance_depth = (
        residual_model[SIGMA_BRIGHTNESS] ** 2,
        residual_model[SIGMA_DEPTH] ** 2,
    )
    for i in range(len(points)):
        brightness, depth = samples[i, _BRIGHTNESS], samples[i, _DEPTH]
        if not np.isnan(brightness) and points[i, HAS_TEXTURE] > 0:
            residual = brightness - gain * points[i, POINT_BRIGHTNESS] - offset
            of_this = variance + points[i, POINT_BRIGHTNESS_VARIANCE]
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + residual * residual / of_this)
                / of_this
            )
            w *= BRIGHTNESS_WEIGHT * cell_weights[_BRIGHTNESS_ROW, int(samples[i, _CELL])]
            fill_jacobian(points[i], POINT_BRIGHTNESS_GRADIENT, gain, J)
            _add_to_sums(sums[int(samples[i, _COLOR_BAND])], J, w, residual)
        if not np.isnan(depth) and points[i, HAS_SHAPE] > 0:
            w = (
                (DEGREES_OF_FREEDOM + 1.0)
                / (DEGREES_OF_FREEDOM + depth * depth / variance_depth)
                / variance_depth
            )
            w *= cell_weights[_DEPTH_ROW, int(samples[i, _CELL])]
            fill_jacobian(points[i], POINT_DEPTH_GRADIENT, 1.0, J)
            _add_to_sums(sums[NUM_ROW_BANDS + int(samples[i, _DEPTH_BAND])], J, w, depth)
    return sums


@inline_kernel
def fill_jacobian(point: Array, gradient_column: int, scale: float, J: Array) -> None:
    """Fill J (6,): scale times (p, x cross p) of the derivative p by the point's place x."""
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
    """Upper triangle of w J J^T, row by row, then w J r."""
    k = 0
    for i in range(6):
        weighted = w * J[i]
        for j in range(i, 6):
            sums[k] += weighted * J[j]
            k += 1
        sums[21 + i] += weighted * residual


@kernel
def band_times(readout_s: float, skew_s: float) -> Array:
    """(2 BANDS,) when the middle of each band was taken, after the frame's stamp."""
    times = np.empty(2 * NUM_ROW_BANDS)
    for n in range(NUM_ROW_BANDS):
        times[n] = ((n + 0.5) / NUM_ROW_BANDS - 0.5) * readout_s
        times[NUM_ROW_BANDS + n] = times[n] + skew_s
    return times


@kernel
def expand_rolling_shutter(sums: Array, readout_s: float, skew_s: float) -> tuple[Array, Array]:
    """Information (15, 15) and vector (15,) of the motion and of the movement.

    With r = J (d + tau e + tau^2 f / 2), e and f small changes of the velocity and of the angular
    acceleration (this with J's rotation only), and tau when the reading was taken: J' = [J, tau J,
    tau^2 J / 2], and sum w J'^T J' and sum w J'^T r.
    """
    H, g = np.zeros((NUM_UNKNOWNS, NUM_UNKNOWNS)), np.zeros(NUM_UNKNOWNS)
    times = band_times(readout_s, skew_s)
    of_band = np.empty((6, 6))
    for n in range(2 * NUM_ROW_BANDS):
        tau = times[n]
        half = 0.5 * tau * tau
        k = 0
        for i in range(6):
            for j in range(i, 6):
                of_band[i, j] = of_band[j, i] = sums[n, k]
                k += 1
        for i in range(6):
            for j in range(6):
                value = of_band[i, j]
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

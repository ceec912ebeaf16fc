"""Warp a keyframe's points into a frame and sample it there, each row at its own time."""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import LevelImages, cell_index
from vo_service.odometry.direct.motion import project, project_rolling_shutter, transform_point
from vo_service.odometry.direct.parameters import (
    MAX_SAME_SURFACE_PER_M,
    MAX_SURFACE_STEP_PER_M,
    MIN_DEPTH_M,
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
    gray, intrinsics, inverse_depth, depth_intrinsics, readout_s, skew_s, vignetting = images
    height, width = inverse_depth.shape
    is_instant = readout_s == 0.0 and skew_s == 0.0
    for n in range(len(points)):
        sample = samples[n]
        _clear_sample(sample)
        x, y, z = transform_point(T_camera_keyframe, points[n, 0], points[n, 1], points[n, 2])
        if z < MIN_DEPTH_M:
            continue
        u, v = project(x, y, z, depth_intrinsics)
        u_depth, v_depth, z_depth = u, v, z
        if not is_instant:
            u, v, _ = project_rolling_shutter(
                motion, x, y, z, depth_intrinsics, height, readout_s, 0.0
            )
            u_depth, v_depth, z_depth = project_rolling_shutter(
                motion, x, y, z, depth_intrinsics, height, readout_s, skew_s
            )
        scale = intrinsics[0] / depth_intrinsics[0]
        brightness = _interpolate_brightness(gray, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5)
        if brightness < 0.0 or z_depth < MIN_DEPTH_M:
            continue
        sample[SAMPLE_U], sample[SAMPLE_V] = u, v
        sample[SAMPLE_CELL] = cell_index(u / width, v / height)
        w = _interpolate_inverse_depth(inverse_depth, u_depth, v_depth)
        difference = w - 1.0 / z_depth
        if w > 0.0 and abs(difference) > MAX_SAME_SURFACE_PER_M:
            sample[SAMPLE_OCCLUSION] = np.sign(difference)
            continue
        if w > 0.0:
            sample[SAMPLE_DEPTH_RESIDUAL] = difference * (z_depth / points[n, 2]) ** 2
            sample[SAMPLE_DEPTH_BAND] = _row_band(v_depth, height)
        if vignetting != 0.0:
            brightness *= 1.0 + vignetting * squared_radius_change(
                u, v, depth_intrinsics, points[n]
            )
        sample[SAMPLE_BRIGHTNESS] = brightness
        sample[SAMPLE_COLOR_BAND] = _row_band(v, height)


@inline_kernel
def squared_radius_change(u: float, v: float, intrinsics: Array, point: Array) -> float:
    """Change of a point's squared radius from its keyframe to a pixel.

    The radius is the tangent of the angle to the optical axis.
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
def _row_band(v: float, height: int) -> int:
    """Index of the band that a row belongs to."""
    return min(max(int(v * NUM_ROW_BANDS / height), 0), NUM_ROW_BANDS - 1)


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

"""What a frame shows where a keyframe's points come to lie in it, each row at its own time."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe.cells import cell_of
from vo_service.odometry.keyframe.limits import SURFACE_STEP_PER_M
from vo_service.odometry.keyframe.rows import project, project_moving
from vo_service.odometry.keyframe.twists import transformed

NEAREST_M = 0.05
# The image is divided into so many bands of rows, each taken as of one instant where times are
# weighed.
BANDS = 16
# Columns of a reading: brightness, 1/z of the surface less that of the point (1/m, as seen from the
# keyframe), the cell, the bands of the colour and of the depth image, and the pixel in the whole
# colour image; NaN or -1 where none. Then whether another surface hides the point (1), or is seen
# through it (-1): that tells neither brightness nor depth.
BRIGHTNESS, DEPTH, CELL, COLOUR_BAND, DEPTH_BAND, U, V, OTHER = range(8)
COLUMNS = 8
HIDDEN = 1.0
# A surface this much (1/m) nearer or further than a point is another one.
OTHER_SURFACE_PER_M = 2.0 * SURFACE_STEP_PER_M


@kernel
def read_points(
    points: Array,
    T_camera_keyframe: Array,
    movement: Array,
    grey: NDArray[np.uint8],
    intrinsics: Array,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    falloff: float,
    readings: Array,
) -> None:
    """Fill in the readings (N, COLUMNS) of points.

    movement  (9,) of the camera in its own axes at the frame's stamp, see `movement`
    falloff   brightness is told as the lens shows it at the point's place in the keyframe
    """
    height, width = inverse_depth.shape
    is_instant = readout_s == 0.0 and skew_s == 0.0
    for n in range(len(points)):
        reading = readings[n]
        _clear(reading)
        x, y, z = transformed(T_camera_keyframe, points[n, 0], points[n, 1], points[n, 2])
        if z < NEAREST_M:
            continue
        u, v = project(x, y, z, depth_intrinsics)
        u_depth, v_depth, z_depth = u, v, z
        if not is_instant:
            u, v, _ = project_moving(movement, x, y, z, depth_intrinsics, height, readout_s, 0.0)
            u_depth, v_depth, z_depth = project_moving(
                movement, x, y, z, depth_intrinsics, height, readout_s, skew_s
            )
        scale = intrinsics[0] / depth_intrinsics[0]
        brightness = _brightness(grey, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5)
        if brightness < 0.0 or z_depth < NEAREST_M:
            continue
        reading[U], reading[V] = u, v
        reading[CELL] = cell_of(u / width, v / height)
        w = _depth(inverse_depth, u_depth, v_depth)
        difference = w - 1.0 / z_depth
        if w > 0.0 and abs(difference) > OTHER_SURFACE_PER_M:
            reading[OTHER] = np.sign(difference)
            continue
        if w > 0.0:
            reading[DEPTH] = difference * (z_depth / points[n, 2]) ** 2
            reading[DEPTH_BAND] = _band(v_depth, height)
        if falloff != 0.0:
            brightness *= 1.0 + falloff * further_out(u, v, depth_intrinsics, points[n])
        reading[BRIGHTNESS] = brightness
        reading[COLOUR_BAND] = _band(v, height)


@inline_kernel
def further_out(u: float, v: float, intrinsics: Array, point: Array) -> float:
    """How much further from the lens's axis a pixel is than a point in its keyframe.

    In squared tangents of the angles to the axis.
    """
    x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
    before = (point[0] * point[0] + point[1] * point[1]) / (point[2] * point[2])
    return float(x * x + y * y - before)


@inline_kernel
def _clear(reading: Array) -> None:
    """Nothing is read."""
    reading[BRIGHTNESS] = reading[DEPTH] = np.nan
    reading[CELL] = reading[COLOUR_BAND] = reading[DEPTH_BAND] = -1.0
    reading[U] = reading[V] = -1.0
    reading[OTHER] = 0.0


@inline_kernel
def _band(v: float, height: int) -> int:
    """Number of the band that a row belongs to."""
    return min(max(int(v * BANDS / height), 0), BANDS - 1)


@inline_kernel
def _brightness(grey: NDArray[np.uint8], u: float, v: float) -> float:
    """Between four pixels; -1 outside of the image."""
    height, width = grey.shape
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return -1.0
    column, row = int(u), int(v)
    right, down = u - column, v - row
    a, b = float(grey[row, column]), float(grey[row, column + 1])
    c, d = float(grey[row + 1, column]), float(grey[row + 1, column + 1])
    above, below = a + right * (b - a), c + right * (d - c)
    return above + down * (below - above)


@inline_kernel
def _depth(inverse_depth: NDArray[np.float32], u: float, v: float) -> float:
    """1/z between four pixels, 1/m; 0 outside, beside a pixel without reading and on an edge."""
    height, width = inverse_depth.shape
    if not (0.0 <= u < width - 1 and 0.0 <= v < height - 1):
        return 0.0
    column, row = int(u), int(v)
    a, b = float(inverse_depth[row, column]), float(inverse_depth[row, column + 1])
    c, d = float(inverse_depth[row + 1, column]), float(inverse_depth[row + 1, column + 1])
    lowest = min(min(a, b), min(c, d))
    if lowest <= 0.0 or max(max(a, b), max(c, d)) - lowest > SURFACE_STEP_PER_M:
        return 0.0
    right, down = u - column, v - row
    above, below = a + right * (b - a), c + right * (d - c)
    return above + down * (below - above)

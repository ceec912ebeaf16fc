"""What a frame shows where a keyframe's points come to lie in it, each row at its own time."""

import numpy as np
from numpy.typing import NDArray

from drivers.geometry import Array
from drivers.jit import inline_kernel, kernel
from vo_service.odometry.keyframe.cells import cell_of
from vo_service.odometry.keyframe.parameters import OTHER_SURFACE_PER_M, SURFACE_STEP_PER_M

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


@kernel
def read_points(
    points: Array,
    T_camera_keyframe: Array,
    velocity: Array,
    grey: NDArray[np.uint8],
    intrinsics: Array,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    readings: Array,
) -> None:
    """Fill in the readings (N, COLUMNS) of points.

    velocity  (6,) twist of the camera in its own axes at the frame's stamp, m/s and rad/s
    """
    T = T_camera_keyframe
    fx, fy, cx, cy = depth_intrinsics
    height, width = inverse_depth.shape
    scale = intrinsics[0] / fx
    is_instant = readout_s == 0.0 and skew_s == 0.0
    row_s, middle = readout_s / height, 0.5 * (height - 1)
    for n in range(len(points)):
        reading = readings[n]
        reading[BRIGHTNESS] = reading[DEPTH] = np.nan
        reading[CELL] = reading[COLOUR_BAND] = reading[DEPTH_BAND] = -1.0
        reading[U] = reading[V] = -1.0
        reading[OTHER] = 0.0
        px, py, pz = points[n, 0], points[n, 1], points[n, 2]
        x = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3]
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if z < NEAREST_M:
            continue
        u, v = fx * x / z + cx, fy * y / z + cy
        u_depth, v_depth, z_depth = u, v, z
        if not is_instant:
            # The point as it moves through the camera's axes while the rows are read.
            ax, ay, az = _drift(velocity, x, y, z)
            bx, by, bz = _turned(velocity, ax, ay, az)
            for _ in range(2):
                tau = (v - middle) * row_s
                half = -0.5 * tau * tau
                zc = z + tau * az + half * bz
                u = fx * (x + tau * ax + half * bx) / zc + cx
                v = fy * (y + tau * ay + half * by) / zc + cy
            v_depth = v
            for _ in range(2):
                tau = skew_s + (v_depth - middle) * row_s
                half = -0.5 * tau * tau
                z_depth = z + tau * az + half * bz
                u_depth = fx * (x + tau * ax + half * bx) / z_depth + cx
                v_depth = fy * (y + tau * ay + half * by) / z_depth + cy
        brightness = _brightness(grey, (u + 0.5) * scale - 0.5, (v + 0.5) * scale - 0.5)
        if brightness < 0.0 or z_depth < NEAREST_M:
            continue
        reading[U], reading[V] = u, v
        reading[CELL] = cell_of(u / width, v / height)
        w = _depth(inverse_depth, u_depth, v_depth)
        if w > 0.0:
            difference = w - 1.0 / z_depth
            if abs(difference) > OTHER_SURFACE_PER_M:
                reading[OTHER] = np.sign(difference)
                continue
            reading[DEPTH] = difference * (z_depth / pz) ** 2
            reading[DEPTH_BAND] = min(max(int(v_depth * BANDS / height), 0), BANDS - 1)
        reading[BRIGHTNESS] = brightness
        reading[COLOUR_BAND] = min(max(int(v * BANDS / height), 0), BANDS - 1)


@inline_kernel
def _drift(velocity: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Velocity of a standing point in the axes of the moving camera: -(v + w x p)."""
    return (
        -(velocity[0] + velocity[4] * z - velocity[5] * y),
        -(velocity[1] + velocity[5] * x - velocity[3] * z),
        -(velocity[2] + velocity[3] * y - velocity[4] * x),
    )


@inline_kernel
def _turned(velocity: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The cross product of the camera's angular velocity and a vector."""
    return (
        velocity[4] * z - velocity[5] * y,
        velocity[5] * x - velocity[3] * z,
        velocity[3] * y - velocity[4] * x,
    )


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

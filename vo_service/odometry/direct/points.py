"""Points of a keyframe, and their selection.

The best pixel of each small block is selected. In a block with texture it is the pixel of the
steepest brightness; else its center, used for depth only. The depth of a point is that of a plane
fitted around it, which averages the sensor's noise.
"""

from collections.abc import Iterable
from itertools import takewhile
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.depth_planes import fit_plane
from vo_service.odometry.direct.brightness_noise import measure_brightness_noise
from vo_service.odometry.direct.image_pyramid import (
    ImagePyramid,
    LevelImages,
    cell_index,
    surface_step,
)
from vo_service.odometry.direct.motion import (
    project,
    propagate_motion,
    propagate_point,
    row_time,
)
from vo_service.odometry.direct.parameters import (
    DYNAMIC_BLOCK_PX,
    INTERPOLATION_PX,
    MAX_PLANE_RMS_RATIO,
    MIN_PLANE_SUPPORT,
    MIN_TEXTURE_GRADIENTS,
    MIN_TEXTURE_SIGMAS,
    PLANE_RADIUS_PX,
    PLANE_STEP_PX,
)

# Depth pixels that a plane is fitted to, to either side.
PLANE_RADIUS_STEPS = PLANE_RADIUS_PX // PLANE_STEP_PX


class Points(NamedTuple):
    """Points of a pyramid level of a keyframe.

    Attributes:
        position_m: (3, N) in the axes of the camera at the frame's stamp.
        brightness: (N,) gray levels.
        brightness_variance: (N,) of its error by interpolation.
        brightness_gradient: (3, N) of the brightness by the position, 1/m.
        depth_gradient: (3, N) of the depth residual by the position, 1/m per m.
        has_texture: (N,) whether the brightness is used.
        has_shape: (N,) whether the depth is used.
    """

    position_m: Array
    brightness: Array
    brightness_variance: Array
    brightness_gradient: Array
    depth_gradient: Array
    has_texture: NDArray[np.bool_]
    has_shape: NDArray[np.bool_]

    def select(self, chosen: NDArray[np.bool_] | slice) -> "Points":
        """Return the points of a mask (N,) or slice."""
        return Points._make(np.ascontiguousarray(each[..., chosen]) for each in self)


def select_points(
    images: ImagePyramid, motion: Array, is_static: NDArray[np.bool_]
) -> tuple[Points, ...]:
    """Select the points of each level.

    Args:
        images: The keyframe.
        motion: (9,) of the camera in its own axes; it corrects each row for its time.
        is_static: (CELLS,) which cells of the image to take points from.

    Returns:
        Those of each level, see `drop_empty_levels`.
    """
    noise = measure_brightness_noise(images.gray[0])
    sizes_px = images.point_blocks_px
    levels = (
        _select_level(
            level_images, sizes_px[level], motion, is_static, smallest_gradient(noise * 0.5**level)
        )
        for level, level_images in enumerate(images.levels)
    )
    if images.body_blocks is not None:
        levels = (
            level.select(~are_in_blocks(level.position_m, images.intrinsics[0], images.body_blocks))
            for level in levels
        )
    return drop_empty_levels(levels)


def smallest_gradient(noise: float) -> float:
    """Smallest brightness gradient of texture, gray levels per pixel, by the noise of a pixel."""
    smallest, largest = MIN_TEXTURE_GRADIENTS
    return float(min(max(MIN_TEXTURE_SIGMAS * noise, smallest), largest))


def drop_empty_levels(levels: Iterable[Points]) -> tuple[Points, ...]:
    """Drop the levels from the first one on that has no points, except the finest."""
    levels = tuple(levels)
    return tuple(takewhile(lambda level: len(level.brightness) > 0, levels)) or levels[:1]


@kernel
def _select_level(
    images: LevelImages,
    block: int,
    motion: Array,
    is_static: NDArray[np.bool_],
    min_gradient: float,
) -> Points:
    """Points of one level, at most one per block of `block` pixels."""
    # Fields of a tuple cost time in a loop.
    gray, intrinsics, inverse_depth, depth_intrinsics, readout_s, skew_s, _, noise = images
    height, width = gray.shape
    # In pixels of this level.
    interpolation_px = INTERPOLATION_PX / (depth_intrinsics[0] / intrinsics[0])
    rows, columns = height // block, width // block
    points, count = _empty_points(rows * columns), 0
    # Squared changes over two pixels.
    squared, min_squared = _squared_gradients(gray), int(np.ceil((2.0 * min_gradient) ** 2))
    for i in range(rows):
        for j in range(columns):
            u, v, gu, gv = _find_steepest_pixel(
                gray, squared, min_squared, j * block, i * block, block
            )
            if u < 0 or not is_static[cell_index(u / width, v / height)]:
                continue
            ray_x = (u - intrinsics[2]) / intrinsics[0]
            ray_y = (v - intrinsics[3]) / intrinsics[1]
            x, y, z, wu, wv, has_shape = _locate_point(
                ray_x,
                ray_y,
                (inverse_depth, noise),
                depth_intrinsics,
                readout_s,
                skew_s,
                motion,
            )
            squared_gradient = gu * gu + gv * gv
            if z == 0.0 or not (has_shape or squared_gradient > 0.0):
                continue
            _set_column(points.position_m, count, x, y, z)
            points.brightness[count] = gray[v, u]
            points.brightness_variance[count] = squared_gradient * interpolation_px**2
            points.has_texture[count], points.has_shape[count] = squared_gradient > 0.0, has_shape
            fx, fy = intrinsics[0] / z, intrinsics[1] / z
            by_z = -(gu * fx * x + gv * fy * y) / z
            _set_column(points.brightness_gradient, count, gu * fx, gv * fy, by_z)
            gx, gy = wu * depth_intrinsics[0], wv * depth_intrinsics[1]
            by_z = -(gx * x + gy * y) / (z * z) + 1.0 / (z * z)
            _set_column(points.depth_gradient, count, gx / z, gy / z, by_z)
            count += 1
    return _first_points(points, count)


@inline_kernel
def _empty_points(count: int) -> Points:
    return Points(
        np.empty((3, count)),
        np.empty(count),
        np.empty(count),
        np.empty((3, count)),
        np.empty((3, count)),
        np.empty(count, np.bool_),
        np.empty(count, np.bool_),
    )


@inline_kernel
def _first_points(points: Points, count: int) -> Points:
    return Points(
        points.position_m[:, :count].copy(),
        points.brightness[:count].copy(),
        points.brightness_variance[:count].copy(),
        points.brightness_gradient[:, :count].copy(),
        points.depth_gradient[:, :count].copy(),
        points.has_texture[:count].copy(),
        points.has_shape[:count].copy(),
    )


@inline_kernel
def _set_column(columns: Array, n: int, x: float, y: float, z: float) -> None:
    columns[0, n], columns[1, n], columns[2, n] = x, y, z


@kernel
def _squared_gradients(gray: NDArray[np.uint8]) -> NDArray[np.int32]:
    """(h, w) squared change of the brightness over two pixels; 0 at the border."""
    height, width = gray.shape
    squared = np.zeros((height, width), np.int32)
    for v in range(1, height - 1):
        above, here, below = gray[v - 1], gray[v], gray[v + 1]
        for u in range(1, width - 1):
            du = np.int32(here[u + 1]) - np.int32(here[u - 1])
            dv = np.int32(below[u]) - np.int32(above[u])
            squared[v, u] = du * du + dv * dv
    return squared


@inline_kernel
def _find_steepest_pixel(
    gray: NDArray[np.uint8],
    squared: NDArray[np.int32],
    min_squared: int,
    left: int,
    top: int,
    block: int,
) -> tuple[int, int, float, float]:
    """Pixel u, v of a block, and its gradient; the center without texture, -1 at the border."""
    height, width = gray.shape
    center = block // 2
    best_u, best_v = left + center, top + center
    if best_u < 1 or best_v < 1 or best_u >= width - 1 or best_v >= height - 1:
        return -1, -1, 0.0, 0.0
    has_texture, largest = False, min_squared
    for v in range(max(top, 1), min(top + block, height - 1)):
        for u in range(max(left, 1), min(left + block, width - 1)):
            if squared[v, u] >= largest:
                has_texture, largest = True, squared[v, u]
                best_u, best_v = u, v
    if not has_texture:
        return best_u, best_v, 0.0, 0.0
    gu = 0.5 * (float(gray[best_v, best_u + 1]) - float(gray[best_v, best_u - 1]))
    gv = 0.5 * (float(gray[best_v + 1, best_u]) - float(gray[best_v - 1, best_u]))
    return best_u, best_v, gu, gv


@kernel
def _locate_point(
    ray_x: float,
    ray_y: float,
    depth: tuple[NDArray[np.float32], float],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    motion: Array,
) -> tuple[float, float, float, float, float, bool]:
    """Position x, y, z of a pixel, slopes of 1/z, whether a plane fits; z = 0 without depth.

    The pixel's ray is (ray_x, ray_y, 1); `depth` is the inverse depth (H, W) and its noise.
    """
    inverse_depth, noise = depth
    height = inverse_depth.shape[0]
    u_depth, v_depth = project(ray_x, ray_y, 1.0, depth_intrinsics)
    tau = row_time(v_depth, height, readout_s)
    shift_m = 0.0
    if readout_s != 0.0 or skew_s != 0.0:
        u_depth, v_depth, shift_m = _find_in_depth_image(
            ray_x, ray_y, tau, inverse_depth, depth_intrinsics, readout_s, skew_s, motion
        )
    w, wu, wv, has_shape = _fit_surface(inverse_depth, u_depth, v_depth, noise)
    if w <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, False
    # To the time of the color row, on its ray; then to the frame's stamp.
    z = 1.0 / w - shift_m
    x, y, z = propagate_point(propagate_motion(motion, tau), ray_x * z, ray_y * z, z, -tau)
    return x, y, z, wu, wv, has_shape


@kernel
def _find_in_depth_image(
    ray_x: float,
    ray_y: float,
    tau: float,
    inverse_depth: NDArray[np.float32],
    depth_intrinsics: Array,
    readout_s: float,
    skew_s: float,
    motion: Array,
) -> tuple[float, float, float]:
    """Pixel in the depth image of the surface on the color ray at `tau`, and its depth change.

    The pixel is -1 if the search meets a pixel without depth.
    """
    height, width = inverse_depth.shape
    u, v = project(ray_x, ray_y, 1.0, depth_intrinsics)
    then, shift_m = propagate_motion(motion, tau), 0.0
    # The time of a row depends on the pixel, and the pixel on the time.
    for _ in range(2):
        column, row = int(u + 0.5), int(v + 0.5)
        if not (0 <= column < width and 0 <= row < height) or inverse_depth[row, column] <= 0:
            return -1.0, -1.0, 0.0
        z = 1.0 / inverse_depth[row, column]
        delay_s = skew_s + row_time(v, height, readout_s) - tau
        x_then, y_then, z_then = propagate_point(then, ray_x * z, ray_y * z, z, delay_s)
        shift_m = z_then - z
        u, v = project(x_then, y_then, z_then, depth_intrinsics)
    return u, v, shift_m


@kernel
def _fit_surface(
    inverse_depth: NDArray[np.float32], u: float, v: float, noise: float
) -> tuple[float, float, float, bool]:
    """1/z at a pixel, its slopes (1/m per pixel), whether a plane fits; 0 at edges and holes."""
    none = (0.0, 0.0, 0.0, False)
    height, width = inverse_depth.shape
    column, row = int(u + 0.5), int(v + 0.5)
    reach = PLANE_RADIUS_STEPS * PLANE_STEP_PX
    if not (reach <= column < width - reach and reach <= row < height - reach):
        return none
    center = inverse_depth[row, column]
    if center <= 0:
        return none
    max_step = surface_step(center, noise)
    for dv in range(-PLANE_STEP_PX, PLANE_STEP_PX + 1, PLANE_STEP_PX):
        for du in range(-PLANE_STEP_PX, PLANE_STEP_PX + 1, PLANE_STEP_PX):
            if not abs(inverse_depth[row + dv, column + du] - center) <= max_step:
                return none
    w, wu, wv, squared = fit_plane(
        inverse_depth,
        column,
        row,
        PLANE_RADIUS_STEPS,
        PLANE_STEP_PX,
        max_step,
        MIN_PLANE_SUPPORT,
    )
    if w <= 0.0:
        return float(center), 0.0, 0.0, False
    return (
        w + wu * (u - column) + wv * (v - row),
        wu,
        wv,
        squared <= (MAX_PLANE_RMS_RATIO * noise) ** 2,
    )


@kernel
def are_in_blocks(
    position_m: Array, intrinsics: Array, is_selected: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(N,) whether points of a keyframe lie in the selected blocks (rows, columns).

    Args:
        position_m: (3, N).
        intrinsics: (4,) of the whole image.
        is_selected: (rows, columns) blocks.
    """
    rows, columns = is_selected.shape
    is_inside = np.zeros(position_m.shape[1], np.bool_)
    for n in range(len(is_inside)):
        u, v = project(position_m[0, n], position_m[1, n], position_m[2, n], intrinsics)
        row = min(max(int(v / DYNAMIC_BLOCK_PX), 0), rows - 1)
        column = min(max(int(u / DYNAMIC_BLOCK_PX), 0), columns - 1)
        is_inside[n] = is_selected[row, column]
    return is_inside

"""Points of a keyframe: their selection, and their samples in a frame.

The best pixel of each small block is selected. In a block with texture it is the pixel of the
steepest brightness; else its center, used for depth only. The depth of a point is that of a plane
fitted around it, which averages the sensor's noise.

A sample is the brightness and depth of a frame where it sees a point, each row at its own time.
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
    project_rolling_shutter,
    propagate_motion,
    propagate_point,
    row_time,
)
from vo_service.odometry.direct.parameters import (
    INTERPOLATION_PX,
    MAX_PLANE_RMS_RATIO,
    MAX_SAME_SURFACE_RATIO,
    MIN_DEPTH_M,
    MIN_PLANE_SUPPORT,
    MIN_TEXTURE_GRADIENTS,
    MIN_TEXTURE_SIGMAS,
    PLANE_RADIUS_PX,
    PLANE_STEP_PX,
)

# Columns of a point: position (x, y, z in m); brightness; its variance by interpolation; gradient
# of the brightness by the position (3, gray / m); gradient of the depth residual by the position
# (3, 1/m / m); and whether brightness and depth are used (0 or 1).
(
    POINT_X,
    POINT_BRIGHTNESS,
    POINT_BRIGHTNESS_VARIANCE,
    POINT_BRIGHTNESS_GRADIENT,
    POINT_DEPTH_GRADIENT,
    HAS_TEXTURE,
    HAS_SHAPE,
) = 0, 3, 4, 5, 8, 11, 12
NUM_POINT_COLUMNS = 13
# The image is divided into this many bands of rows; all rows of a band get the same time.
NUM_ROW_BANDS = 16
# Depth pixels that a plane is fitted to, to either side.
PLANE_RADIUS_STEPS = PLANE_RADIUS_PX // PLANE_STEP_PX


class Samples(NamedTuple):
    """Samples of N points in a frame; NaN or -1 where there is none.

    Attributes:
        brightness: (N,) gray levels.
        depth_residual: (N,) 1/z of the surface minus that of the point, as seen from the keyframe,
            1/m.
        cell: (N,) cell of the image.
        color_band: (N,) band of rows of the color image.
        depth_band: (N,) band of rows of the depth image.
        u: (N,) column in the whole color image.
        v: (N,) row in it.
        occlusion: (N,) 1 if another surface is in front of the point, -1 if the point is in free
            space. Such a sample has neither brightness nor depth.
    """

    brightness: Array
    depth_residual: Array
    cell: NDArray[np.int32]
    color_band: NDArray[np.int32]
    depth_band: NDArray[np.int32]
    u: Array
    v: Array
    occlusion: NDArray[np.int32]


def select_points(
    images: ImagePyramid, motion: Array, is_static: NDArray[np.bool_]
) -> tuple[Array, ...]:
    """Select the points of each level.

    Args:
        images: The keyframe.
        motion: (9,) of the camera in its own axes; it corrects each row for its time.
        is_static: (CELLS,) which cells of the image to take points from.

    Returns:
        (N, COLUMNS) for each level, see `drop_sparse_levels`, in the axes of the camera at the
        frame's stamp. Columns are contiguous (Fortran order), so that the compiler vectorizes loops
        over points.
    """
    noise = measure_brightness_noise(images.gray[0])
    sizes_px = images.point_blocks_px
    return drop_sparse_levels(
        np.asfortranarray(
            _select_level(
                level_images,
                sizes_px[level],
                motion,
                is_static,
                smallest_gradient(noise * 0.5**level),
            )
        )
        for level, level_images in enumerate(images.levels)
    )


def smallest_gradient(noise: float) -> float:
    """Smallest brightness gradient of texture, gray levels per pixel, by the noise of a pixel."""
    smallest, largest = MIN_TEXTURE_GRADIENTS
    return float(min(max(MIN_TEXTURE_SIGMAS * noise, smallest), largest))


def drop_sparse_levels(levels: Iterable[Array]) -> tuple[Array, ...]:
    """Drop the levels from the first one on that has fewer than two points; the finest is empty.

    To Numba, an array of one row has another layout, and a kernel takes levels of one layout.
    """
    levels = tuple(levels)
    return tuple(takewhile(lambda level: len(level) > 1, levels)) or (levels[0][:0],)


@kernel
def _select_level(
    images: LevelImages,
    block: int,
    motion: Array,
    is_static: NDArray[np.bool_],
    min_gradient: float,
) -> Array:
    """(N, COLUMNS) points of one level, at most one per block of `block` pixels."""
    # Fields of a tuple cost time in a loop.
    gray, intrinsics, inverse_depth, depth_intrinsics, readout_s, skew_s, _, noise = images
    height, width = gray.shape
    scale = depth_intrinsics[0] / intrinsics[0]
    rows, columns = height // block, width // block
    points, count = np.empty((rows * columns, NUM_POINT_COLUMNS)), 0
    # Squared changes over two pixels.
    squared, min_squared = _squared_gradients(gray), int(np.ceil((2.0 * min_gradient) ** 2))
    for i in range(rows):
        for j in range(columns):
            u, v, gu, gv = _find_steepest_pixel(
                gray, squared, min_squared, j * block, i * block, block
            )
            if u < 0 or not is_static[cell_index(u / width, v / height)]:
                continue
            point = points[count]
            ray_x = (u - intrinsics[2]) / intrinsics[0]
            ray_y = (v - intrinsics[3]) / intrinsics[1]
            if not _locate_point(
                ray_x,
                ray_y,
                (inverse_depth, noise),
                depth_intrinsics,
                readout_s,
                skew_s,
                motion,
                point,
            ):
                continue
            _describe_texture(point, gray[v, u], gu, gv, intrinsics, scale)
            if point[HAS_TEXTURE] > 0 or point[HAS_SHAPE] > 0:
                count += 1
    return points[:count]


@inline_kernel
def _describe_texture(
    point: Array, brightness: int, gu: float, gv: float, intrinsics: Array, scale: float
) -> None:
    """Fill in the brightness of a located point, with its gradient (gu, gv) per pixel.

    The whole size is `scale` times that of the level with these intrinsics.
    """
    point[POINT_BRIGHTNESS] = brightness
    squared = gu * gu + gv * gv
    point[HAS_TEXTURE] = 1.0 if squared > 0.0 else 0.0
    point[POINT_BRIGHTNESS_VARIANCE] = squared * (INTERPOLATION_PX / scale) ** 2
    x, y, z = point[POINT_X], point[POINT_X + 1], point[POINT_X + 2]
    fx, fy = intrinsics[0] / z, intrinsics[1] / z
    point[POINT_BRIGHTNESS_GRADIENT] = gu * fx
    point[POINT_BRIGHTNESS_GRADIENT + 1] = gv * fy
    point[POINT_BRIGHTNESS_GRADIENT + 2] = -(gu * fx * x + gv * fy * y) / z


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
    point: Array,
) -> bool:
    """Fill in the position and the depth gradient of a pixel; False if it has no depth.

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
        return False
    # To the time of the color row, on its ray; then to the frame's stamp.
    z = 1.0 / w - shift_m
    x, y, z = propagate_point(propagate_motion(motion, tau), ray_x * z, ray_y * z, z, -tau)
    fx, fy = depth_intrinsics[0], depth_intrinsics[1]
    point[POINT_X], point[POINT_X + 1], point[POINT_X + 2] = x, y, z
    point[POINT_DEPTH_GRADIENT] = wu * fx / z
    point[POINT_DEPTH_GRADIENT + 1] = wv * fy / z
    point[POINT_DEPTH_GRADIENT + 2] = -(wu * fx * x + wv * fy * y) / (z * z) + 1.0 / (z * z)
    point[HAS_SHAPE] = 1.0 if has_shape else 0.0
    return True


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
def empty_samples(count: int) -> Samples:
    """Arrays for the samples of N points."""
    return Samples(
        np.empty(count),
        np.empty(count),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count, np.int32),
        np.empty(count),
        np.empty(count),
        np.empty(count, np.int32),
    )


@kernel
def warp_and_sample(
    points: Array, images: LevelImages, T_camera_keyframe: Array, motion: Array, samples: Samples
) -> None:
    """Fill in the samples of points.

    Args:
        points: (N, COLUMNS) of a keyframe level.
        images: The frame at that level.
        T_camera_keyframe: 4x4.
        motion: (9,) of the camera in its own axes at the frame's stamp, see `motion`.
        samples: Of the points, out.
    """
    u_color, v_color, u_depth, v_depth, inverse_z = project_rolling_shutter(
        points, images, T_camera_keyframe, motion
    )
    scale = images.intrinsics[0] / images.depth_intrinsics[0]
    brightness = _sample_brightness(images.gray, u_color, v_color, scale)
    surface = _sample_inverse_depth(images.inverse_depth, u_depth, v_depth, images.depth_noise)
    pixels = u_color, v_color, v_depth
    _fill_samples(pixels, inverse_z, brightness, surface, points, images, samples)
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
def _sample_inverse_depth(
    inverse_depth: NDArray[np.float32], u: Array, v: Array, noise: float
) -> Array:
    """(N,) bilinear 1/z, 1/m, at pixels (N,); 0 outside, at edges, and next to a missing reading.

    Args:
        inverse_depth: (H, W), 1/m; 0 = no reading.
        u: (N,) columns.
        v: (N,) rows.
        noise: Of the inverse depth, 1/m.
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
        span = max(max(a, b), max(c, d)) - lowest
        if lowest <= 0.0 or span > surface_step(lowest, noise):
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
    images: LevelImages,
    samples: Samples,
) -> None:
    """Fill in the samples. Without branches, so that the compiler vectorizes the loop.

    Args:
        pixels: (N,) column and row in the color image, row in the depth image.
        inverse_z: (N,) 1/z of the points, 1/m.
        brightness: (N,) of the frame; -1 outside.
        surface: (N,) 1/z of the frame, 1/m; 0 without a reading.
        points: (N, COLUMNS) of a keyframe level.
        images: The frame, for its size and noise.
        samples: Of the points, out.
    """
    height, width = images.inverse_depth.shape
    noise = images.depth_noise
    per_width, per_height = 1.0 / width, 1.0 / height
    u_color, v_color, v_depth = pixels
    # Fields of a tuple cost time in a loop.
    sampled, residuals, cells, color_bands, depth_bands, us, vs, occlusions = samples
    for n in range(len(points)):
        u, v, w_point, w = u_color[n], v_color[n], inverse_z[n], surface[n]
        in_image = (brightness[n] >= 0.0) & (w_point > 0.0) & (w_point <= 1.0 / MIN_DEPTH_M)
        difference = w - w_point
        has_surface = in_image & (w > 0.0)
        same_surface = MAX_SAME_SURFACE_RATIO * surface_step(w_point, noise)
        is_other_surface = has_surface & (abs(difference) > same_surface)
        is_same_surface = has_surface & (not is_other_surface)
        is_visible = in_image & (not is_other_surface)
        us[n] = u if in_image else -1.0
        vs[n] = v if in_image else -1.0
        cells[n] = cell_index(u * per_width, v * per_height) if in_image else -1
        occlusions[n] = np.sign(difference) if is_other_surface else 0
        residual = difference / (w_point * points[n, 2]) ** 2
        residuals[n] = residual if is_same_surface else np.nan
        depth_bands[n] = _row_band(v_depth[n] * per_height) if is_same_surface else -1
        sampled[n] = brightness[n] if is_visible else np.nan
        color_bands[n] = _row_band(v * per_height) if is_visible else -1


@kernel
def _correct_vignetting(
    vignetting: float, points: Array, intrinsics: Array, samples: Samples
) -> None:
    """Correct the brightness of samples to that at the keyframe's pixel."""
    for n in range(len(points)):
        change = squared_radius_change(samples.u[n], samples.v[n], intrinsics, points[n])
        samples.brightness[n] *= 1.0 + vignetting * change


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

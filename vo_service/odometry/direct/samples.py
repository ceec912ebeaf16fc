"""Samples: the brightness and depth of a frame where it sees a keyframe's points.

Each row of the frame is seen at its own time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.image_pyramid import LevelImages, cell_index, surface_step
from vo_service.odometry.direct.motion import project_rolling_shutter
from vo_service.odometry.direct.parameters import MAX_SAME_SURFACE_RATIO, MIN_DEPTH_M
from vo_service.odometry.direct.points import Points

# The image is divided into this many bands of rows; all rows of a band get the same time.
NUM_ROW_BANDS = 16


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
    points: Points, images: LevelImages, T_camera_keyframe: Array, motion: Array, samples: Samples
) -> None:
    """Fill in the samples of points.

    Args:
        points: Of a keyframe level.
        images: The frame at that level.
        T_camera_keyframe: 4x4.
        motion: (9,) of the camera in its own axes at the frame's stamp, see `motion`.
        samples: Of the points, out.
    """
    u_color, v_color, u_depth, v_depth, inverse_z = project_rolling_shutter(
        points.position_m, images, T_camera_keyframe, motion
    )
    scale = images.intrinsics[0] / images.depth_intrinsics[0]
    brightness = _sample_brightness(images.gray, u_color, v_color, scale)
    surface = _sample_inverse_depth(images.inverse_depth, u_depth, v_depth, images.depth_noise)
    pixels = u_color, v_color, v_depth
    _fill_samples(pixels, inverse_z, brightness, surface, points.position_m[2], images, samples)
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
    z_keyframe: Array,
    images: LevelImages,
    samples: Samples,
) -> None:
    """Fill in the samples. Without branches, so that the compiler vectorizes the loop.

    Args:
        pixels: (N,) column and row in the color image, row in the depth image.
        inverse_z: (N,) 1/z of the points, 1/m.
        brightness: (N,) of the frame; -1 outside.
        surface: (N,) 1/z of the frame, 1/m; 0 without a reading.
        z_keyframe: (N,) of the points in the keyframe's axes, m.
        images: The frame, for its size and noise.
        samples: Of the points, out.
    """
    height, width = images.inverse_depth.shape
    noise = images.depth_noise
    per_width, per_height = 1.0 / width, 1.0 / height
    u_color, v_color, v_depth = pixels
    # Fields of a tuple cost time in a loop.
    sampled, residuals, cells, color_bands, depth_bands, us, vs, occlusions = samples
    for n in range(len(inverse_z)):
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
        residual = difference / (w_point * z_keyframe[n]) ** 2
        residuals[n] = residual if is_same_surface else np.nan
        depth_bands[n] = _row_band(v_depth[n] * per_height) if is_same_surface else -1
        sampled[n] = brightness[n] if is_visible else np.nan
        color_bands[n] = _row_band(v * per_height) if is_visible else -1


@kernel
def _correct_vignetting(
    vignetting: float, points: Points, intrinsics: Array, samples: Samples
) -> None:
    """Correct the brightness of samples to that at the keyframe's pixel."""
    for n in range(len(points.brightness)):
        u, v = samples.u[n], samples.v[n]
        change = squared_radius_change(u, v, intrinsics, points.position_m, n)
        samples.brightness[n] *= 1.0 + vignetting * change


@inline_kernel
def squared_radius_change(
    u: float, v: float, intrinsics: Array, position_m: Array, n: int
) -> float:
    """Change of a point's squared radius from its keyframe to a pixel.

    The radius is the tangent of the angle to the optical axis.

    Args:
        u: Pixel in the whole image.
        v: See u.
        intrinsics: (4,) of the whole image.
        position_m: (3, N) of a keyframe's points.
        n: Index of the point.
    """
    x, y = (u - intrinsics[2]) / intrinsics[0], (v - intrinsics[3]) / intrinsics[1]
    x_keyframe, y_keyframe, z = position_m[0, n], position_m[1, n], position_m[2, n]
    before = (x_keyframe * x_keyframe + y_keyframe * y_keyframe) / (z * z)
    return float(x * x + y * y - before)


@inline_kernel
def _row_band(v_share: float) -> int:
    """Index of the band that a row belongs to, given as a share of the image's height."""
    return min(max(int(v_share * NUM_ROW_BANDS), 0), NUM_ROW_BANDS - 1)

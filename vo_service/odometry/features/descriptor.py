"""Description of SURF keypoints: direction (Bay et al. 2008, Section 4.1), 64 numbers (4.2).

The paper samples Haar wavelets on the integral image. Sampling a smoothed pyramid instead, at the
keypoint's own scale, is invariant to rotation between pixels, matches better and costs less. The
gray values at half, quarter, ... size are packed so that a bilinear sample is one load.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.features.detector import SCALE, X, Y

NUM_LEVELS = 4  # the largest keypoints (scale 14) are sampled at an eighth of the size


class PackedPyramid(NamedTuple):
    """All levels in one table; entry (x, y) of a level has the gray values of a 2x2 square.

    Attributes:
        packed: (sum of level sizes,) uint32: (x, y), (x+1, y), (x, y+1), (x+1, y+1), low byte
            first.
        level_table: (LEVELS, 3) int64: offset into `packed`, height, width of each level.
    """

    packed: NDArray[np.uint32]
    level_table: NDArray[np.int64]


class PackedLevel(NamedTuple):
    """One level of a packed pyramid: where it starts in the table, and its size in pixels."""

    packed: NDArray[np.uint32]
    offset: int
    height: int
    width: int


def packed_size(height: int, width: int) -> int:
    """Length of the packed table of an image."""
    return sum((height >> level) * (width >> level) for level in range(NUM_LEVELS))


def build_pyramid(
    gray: NDArray[np.uint8], packed: NDArray[np.uint32] | None = None
) -> PackedPyramid:
    """Smooth an image, halve it NUM_LEVELS - 1 times by area, and pack it.

    Args:
        gray: (H, W), at least 16x16.
        packed: The table, (`packed_size`,), overwritten; a new one if None.
    """
    if packed is None:
        packed = np.empty(packed_size(*gray.shape), np.uint32)
    images = [_smooth(gray)]
    for _ in range(1, NUM_LEVELS):
        images.append(_halve(images[-1]))
    offsets = np.concatenate(([0], np.cumsum([image.size for image in images])[:-1]))
    level_table = np.array(
        [(offset, *image.shape) for offset, image in zip(offsets, images, strict=True)], np.int64
    )
    for offset, image in zip(offsets, images, strict=True):
        _pack(image, packed[offset : offset + image.size])
    return PackedPyramid(packed, level_table)


def _smooth(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    smooth: NDArray[np.uint8] = cv2.GaussianBlur(image, (3, 3), 0.7)  # type: ignore[assignment]
    return smooth


def _halve(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape
    half: NDArray[np.uint8] = cv2.resize(
        image, (width // 2, height // 2), interpolation=cv2.INTER_AREA
    )  # type: ignore[assignment]
    return half


@kernel
def _pack(image: NDArray[np.uint8], packed: NDArray[np.uint32]) -> None:
    height, width = image.shape
    for y in range(height):
        upper = image[y]
        lower = image[min(y + 1, height - 1)]
        out = packed[y * width : (y + 1) * width]
        for x in range(width - 1):
            top = np.uint32(upper[x]) | np.uint32(upper[x + 1]) << np.uint32(8)
            bottom = np.uint32(lower[x]) | np.uint32(lower[x + 1]) << np.uint32(8)
            out[x] = top | bottom << np.uint32(16)
        corner = np.uint32(upper[width - 1]) | np.uint32(lower[width - 1]) << np.uint32(16)
        out[width - 1] = corner | corner << np.uint32(8)


@inline_kernel
def level_for_scale(scale: np.float32) -> int:
    """Level at which a keypoint's sample spacing is between 0.9 and 1.8 pixels."""
    level = 0
    while scale > 1.8 and level < NUM_LEVELS - 1:
        scale *= np.float32(0.5)
        level += 1
    return level


def centered_grid(side: int) -> NDArray[np.float32]:
    """(2, side * side) whole-number offsets (along, down) of a square grid from its center."""
    offsets = np.arange(side, dtype=np.float32) - side // 2
    down, along = np.meshgrid(offsets, offsets, indexing="ij")
    return np.stack([along.ravel(), down.ravel()])


@inline_kernel
def rotate_grid(
    x: np.float32,
    y: np.float32,
    co: np.float32,
    si: np.float32,
    offsets: NDArray[np.float32],
    us: NDArray[np.float32],
    vs: NDArray[np.float32],
) -> None:
    """Positions of a grid around (x, y); (co, si) is the spacing along the grid's first axis.

    Args:
        x: Position of the center, pixels.
        y: See x.
        co: Spacing along the grid's first axis: its x.
        si: Its y.
        offsets: (2, N) whole numbers, see `centered_grid`.
        us: (N,) x of the positions, out.
        vs: (N,) y of the positions, out.
    """
    for k in range(us.size):
        us[k] = x + co * offsets[0, k] - si * offsets[1, k]
        vs[k] = y + si * offsets[0, k] + co * offsets[1, k]


@inline_kernel
def sample_bilinear(
    level: PackedLevel,
    x: NDArray[np.float32],
    y: NDArray[np.float32],
    where: NDArray[np.int32],
    squares: NDArray[np.uint32],
    out: NDArray[np.float32],
) -> None:
    """Bilinear gray values at the positions (x, y) of one level, clamped to the image.

    All arrays have one length; `where` and `squares` are scratch, and x and y are overwritten.
    There are three loops, as only the middle one, the loads, does not vectorize.

    Args:
        x: (N,) positions, overwritten.
        y: (N,) positions, overwritten.
        where: (N,) scratch.
        squares: (N,) scratch.
        out: (N,) gray values, out.
    """
    packed = level.packed
    zero = np.float32(0.0)
    right, bottom = np.float32(level.width - 1), np.float32(level.height - 1)
    pitch, start = np.int32(level.width), np.int32(level.offset)
    for k in range(out.size):
        u, v = x[k], y[k]
        u = u if u > zero else zero
        v = v if v > zero else zero
        u = u if u < right else right
        v = v if v < bottom else bottom
        column, row = np.int32(u), np.int32(v)
        x[k] = u - np.float32(column)
        y[k] = v - np.float32(row)
        where[k] = np.int32(start + np.int32(row * pitch)) + column
    for k in range(out.size):
        squares[k] = packed[np.uint32(where[k])]
    byte = np.uint32(255)
    for k in range(out.size):
        square = squares[k]
        p00 = np.float32(np.int32(square & byte))
        p01 = np.float32(np.int32((square >> np.uint32(8)) & byte))
        p10 = np.float32(np.int32((square >> np.uint32(16)) & byte))
        p11 = np.float32(np.int32(square >> np.uint32(24)))
        upper = p00 + x[k] * (p01 - p00)
        lower = p10 + x[k] * (p11 - p10)
        out[k] = upper + y[k] * (lower - upper)


DESCRIPTOR_SIZE = 64
REGIONS_PER_SIDE = 4  # 4x4 square regions
SAMPLES_PER_REGION = 5  # of 5x5 samples each
WINDOW_SIDE = REGIONS_PER_SIDE * SAMPLES_PER_REGION  # the window is 20 s wide
PATCH_SIDE = WINDOW_SIDE + 1  # gray values per side: differences lie between them
# Descriptors are whole numbers with this norm: matching is as good, and dot products are exact in
# float32 in any order of summation.
DESCRIPTOR_NORM = 300.0
RADIUS = 6  # Haar responses within 6 s of the keypoint
GRID_SIDE = 2 * RADIUS + 3  # samples per side: the responses and a margin of one
NUM_BINS = 72  # of 5 degrees
WINDOW_BINS = NUM_BINS // 6  # a sliding window of 60 degrees
SUMS_SIZE = NUM_BINS + WINDOW_BINS  # the first bins are repeated behind the last


def disc_weights() -> NDArray[np.float32]:
    """(13 * 15,) Gaussian of 2.5 s about the keypoint, zero beyond 6 s.

    A row has two unused columns: then the differences of all samples are one loop over `gray`.
    """
    down, along = np.mgrid[-RADIUS : RADIUS + 1, -RADIUS : RADIUS + 3]
    squared = down**2 + along**2
    weights: Array = np.exp(-squared / (2 * 2.5**2)) * (squared <= RADIUS**2)
    return weights.astype(np.float32).ravel()


@kernel
def dominant_direction(
    gray: NDArray[np.float32],
    weights: NDArray[np.float32],
    inside: NDArray[np.int64],
    dxs: NDArray[np.float32],
    dys: NDArray[np.float32],
    bins: NDArray[np.int32],
    sum_x: NDArray[np.float32],
    sum_y: NDArray[np.float32],
) -> tuple[np.float32, np.float32]:
    """Find the longest sum of Haar responses in any 60-degree window.

    Args:
        gray: (15 * 15,) samples at the keypoint's spacing.
        weights: (13 * 15,), see `disc_weights`.
        inside: (N,) indices of the weights that are not zero.
        dxs: Scratch, at least as long as `weights`.
        dys: Scratch, at least as long as `weights`.
        bins: Scratch, at least as long as `weights`.
        sum_x: Scratch, see `SUMS_SIZE`.
        sum_y: Scratch, see `SUMS_SIZE`.

    Returns:
        Cosine and sine of its angle.
    """
    sum_x[:] = 0
    sum_y[:] = 0
    left, right = gray[GRID_SIDE:], gray[GRID_SIDE + 2 :]
    upper, lower = gray[1:], gray[2 * GRID_SIDE + 1 :]
    for k in range(weights.size - 2):
        dx = weights[k] * (right[k] - left[k])
        dy = weights[k] * (lower[k] - upper[k])
        dxs[k], dys[k] = dx, dy
        bins[k] = _direction_bin(dx, dy)
    for i in range(inside.size):
        # Unsigned: a signed index would be tested for being negative.
        sample = np.uint32(inside[i])
        direction = np.uint32(bins[sample])
        sum_x[direction] += dxs[sample]
        sum_y[direction] += dys[sample]
    return _find_longest_window(sum_x, sum_y)


@inline_kernel
def _direction_bin(dx: np.float32, dy: np.float32) -> np.int32:
    """Bin of the angle of (dx, dy); a polynomial without branches, accurate to 0.3 degrees."""
    ax, ay = abs(dx), abs(dy)
    small = ax if ax < ay else ay
    large = ax if ax > ay else ay
    a = small / (large + np.float32(1e-20))
    s = a * a
    angle = (
        (np.float32(-0.0464964749) * s + np.float32(0.15931422)) * s - np.float32(0.327622764)
    ) * s * a + a
    angle = np.float32(np.pi / 2) - angle if ay > ax else angle
    angle = np.float32(np.pi) - angle if dx < 0 else angle
    angle = np.float32(2 * np.pi) - angle if dy < 0 else angle
    direction = np.int32(angle * np.float32(NUM_BINS / (2 * np.pi)))
    return direction if direction < NUM_BINS else np.int32(NUM_BINS - 1)


@kernel
def _find_longest_window(
    sum_x: NDArray[np.float32], sum_y: NDArray[np.float32]
) -> tuple[np.float32, np.float32]:
    """Longest sum of a window of bins; the first bins are repeated behind the last."""
    wx = np.float32(0.0)
    wy = np.float32(0.0)
    for k in range(WINDOW_BINS):
        wx += sum_x[k]
        wy += sum_y[k]
        sum_x[NUM_BINS + k], sum_y[NUM_BINS + k] = sum_x[k], sum_y[k]
    best_x, best_y, best = wx, wy, wx * wx + wy * wy
    entering_x, entering_y = sum_x[WINDOW_BINS:], sum_y[WINDOW_BINS:]
    for k in range(NUM_BINS - 1):
        wx += entering_x[k] - sum_x[k]
        wy += entering_y[k] - sum_y[k]
        length = wx * wx + wy * wy
        if length > best:
            best_x, best_y, best = wx, wy, length
    if best <= 0.0:
        return np.float32(1.0), np.float32(0.0)
    norm = np.float32(np.sqrt(best))
    return best_x / norm, best_y / norm


def patch_weights() -> NDArray[np.float32]:
    """(20 * 21,) Gaussian about the keypoint; 4.5 s matches better than the paper's 3.3 s."""
    offsets = np.arange(PATCH_SIDE) - (WINDOW_SIDE - 1) / 2
    squared = offsets[:WINDOW_SIDE, None] ** 2 + offsets[None, :] ** 2
    return np.exp(-squared / (2 * 4.5**2)).astype(np.float32).ravel()


class Templates(NamedTuple):
    """Weights and grids of the samples around a keypoint.

    Attributes:
        disc_weights: See `disc_weights`.
        inside_disc: (N,) indices of the weights that are not zero.
        disc_grid: (2, 15 * 15) offsets.
        patch_weights: See `patch_weights`.
        patch_grid: (2, 21 * 21) offsets.
    """

    disc_weights: NDArray[np.float32]
    inside_disc: NDArray[np.int64]
    disc_grid: NDArray[np.float32]
    patch_weights: NDArray[np.float32]
    patch_grid: NDArray[np.float32]


def make_templates() -> Templates:
    """The weights and grids, which are the same for all keypoints."""
    weights = disc_weights()
    return Templates(
        weights,
        np.flatnonzero(weights),
        centered_grid(GRID_SIDE),
        patch_weights(),
        centered_grid(PATCH_SIDE),
    )


@kernel
def describe(
    pyramid: PackedPyramid,
    keypoints: NDArray[np.float32],
    upright: bool,
    templates: Templates,
    directions: NDArray[np.float32],
    descriptors: NDArray[np.float32],
) -> None:
    """Orient and describe all keypoints of a table.

    Args:
        pyramid: Of the image.
        keypoints: (N, 5), see `detector`.
        upright: Whether all directions are (1, 0).
        templates: Of the samples.
        directions: (N, 2) as (cos, sin), out.
        descriptors: (N, 64), out: for each region the sums of dx, dy, |dx| and |dy|, in the
            keypoint's own axes.
    """
    us = np.empty(PATCH_SIDE * PATCH_SIDE, np.float32)
    vs = np.empty(PATCH_SIDE * PATCH_SIDE, np.float32)
    where = np.empty(PATCH_SIDE * PATCH_SIDE, np.int32)
    squares = np.empty(PATCH_SIDE * PATCH_SIDE, np.uint32)
    gray = np.empty(PATCH_SIDE * PATCH_SIDE, np.float32)
    dx = np.zeros(WINDOW_SIDE * PATCH_SIDE + 3, np.float32)
    dy = np.zeros(WINDOW_SIDE * PATCH_SIDE + 3, np.float32)
    sums = np.empty((4, WINDOW_SIDE + 4), np.float32)
    sum_x, sum_y = np.empty(SUMS_SIZE, np.float32), np.empty(SUMS_SIZE, np.float32)
    cells = GRID_SIDE * GRID_SIDE
    levels = pyramid.level_table
    full_height, full_width = levels[0, 1], levels[0, 2]
    for n in range(len(keypoints)):
        level = level_for_scale(keypoints[n, SCALE])
        height, width = levels[level, 1], levels[level, 2]
        packed = PackedLevel(pyramid.packed, levels[level, 0], height, width)
        half = np.float32(0.5)
        zoom_x = np.float32(width) / np.float32(full_width)
        zoom_y = np.float32(height) / np.float32(full_height)
        x = (keypoints[n, X] + half) * zoom_x - half
        y = (keypoints[n, Y] + half) * zoom_y - half
        spacing = keypoints[n, SCALE] * zoom_x
        co, si = np.float32(1.0), np.float32(0.0)
        if not upright:
            rotate_grid(x, y, spacing, np.float32(0.0), templates.disc_grid, us[:cells], vs[:cells])
            sample_bilinear(
                packed, us[:cells], vs[:cells], where[:cells], squares[:cells], gray[:cells]
            )
            co, si = dominant_direction(
                gray[:cells],
                templates.disc_weights,
                templates.inside_disc,
                us,
                vs,
                where,
                sum_x,
                sum_y,
            )
        directions[n, 0], directions[n, 1] = co, si
        rotate_grid(x, y, spacing * co, spacing * si, templates.patch_grid, us, vs)
        sample_bilinear(packed, us, vs, where, squares, gray)
        total = _sum_regions(gray, templates.patch_weights, dx, dy, sums, descriptors[n])
        _normalize(descriptors[n], total)


@kernel
def _sum_regions(
    gray: NDArray[np.float32],
    weights: NDArray[np.float32],
    dx: NDArray[np.float32],
    dy: NDArray[np.float32],
    sums: NDArray[np.float32],
    out: NDArray[np.float32],
) -> np.float32:
    """Sums of weighted Haar responses over 5x5 samples: first down the columns, then along.

    Scratch: dx and dy (20 * 21 + 3,), where the last of 21 columns is unused, and sums (4, 24), of
    which the last four are: loops over 24 values are whole vectors.

    Returns:
        The sum of the absolute values of `out`.
    """
    upper, upper_right = gray, gray[1:]
    lower, lower_right = gray[PATCH_SIDE:], gray[PATCH_SIDE + 1 :]
    for k in range(WINDOW_SIDE * PATCH_SIDE - 1):
        falling = lower_right[k] - upper[k]
        rising = upper_right[k] - lower[k]
        dx[k] = weights[k] * (falling + rising)
        dy[k] = weights[k] * (falling - rising)
    absolute_total = np.float32(0.0)
    for region_row in range(REGIONS_PER_SIDE):
        first = region_row * SAMPLES_PER_REGION * PATCH_SIDE
        _sum_five_rows(dx[first:], sums[0], sums[2])
        _sum_five_rows(dy[first:], sums[1], sums[3])
        for region_column in range(REGIONS_PER_SIDE):
            first = region_column * SAMPLES_PER_REGION
            for kind in range(4):
                total = np.float32(0.0)
                for k in range(first, first + SAMPLES_PER_REGION):
                    total += sums[kind, k]
                out[4 * (region_row * REGIONS_PER_SIDE + region_column) + kind] = total
                absolute_total += abs(total)
    return absolute_total


@inline_kernel
def _sum_five_rows(
    values: NDArray[np.float32], sums: NDArray[np.float32], absolute_sums: NDArray[np.float32]
) -> None:
    """Sums of five rows of the patch, by column, and of their absolute values."""
    for k in range(sums.size):
        a, b = values[k], values[k + PATCH_SIDE]
        c, d = values[k + 2 * PATCH_SIDE], values[k + 3 * PATCH_SIDE]
        e = values[k + 4 * PATCH_SIDE]
        sums[k] = a + b + c + d + e
        absolute_sums[k] = abs(a) + abs(b) + abs(c) + abs(d) + abs(e)


@kernel
def _normalize(descriptor: NDArray[np.float32], total: np.float32) -> None:
    """Signed square root, then constant length, then whole numbers.

    `total` is the sum of the absolute values. The square root (Arandjelovic and
    Zisserman, CVPR 2012) reduces the effect of a few strong gradients: 3 to 4 % more matches are
    right.
    """
    gain = (
        np.float32(DESCRIPTOR_NORM) / np.float32(np.sqrt(total)) if total > 0 else np.float32(0.0)
    )
    for k in range(DESCRIPTOR_SIZE):
        v = descriptor[k]
        root = gain * np.float32(np.sqrt(abs(v)))
        rounded = np.float32(np.floor(root + np.float32(0.5)))
        descriptor[k] = rounded if v >= 0 else -rounded

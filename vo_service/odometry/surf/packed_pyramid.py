"""Gray values at half, quarter, ... size, packed so that a bilinear sample is one load.

The paper samples Haar wavelets on the integral image. Sampling a smoothed pyramid instead, at the
keypoint's own scale, is invariant to rotation between pixels, matches better and costs less.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.core.jit import inline_kernel, kernel

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


def build_pyramid(gray: NDArray[np.uint8]) -> PackedPyramid:
    """Smooth an image (H, W), at least 16x16, halve it LEVELS - 1 times by area, and pack it."""
    images = [_smooth(gray)]
    for _ in range(1, NUM_LEVELS):
        images.append(_halve(images[-1]))
    sizes = [image.size for image in images]
    offsets = np.concatenate(([0], np.cumsum(sizes)[:-1]))
    level_table = np.array(
        [(offset, *image.shape) for offset, image in zip(offsets, images, strict=True)], np.int64
    )
    packed = np.empty(sum(sizes), np.uint32)
    for offset, image in zip(offsets, images, strict=True):
        _pack(image, packed[offset : offset + image.size])
    return PackedPyramid(packed, level_table)


def _smooth(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    smooth: NDArray[np.uint8] = cv2.GaussianBlur(image, (3, 3), 0.7)  # type: ignore[assignment]
    return smooth


def _halve(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    height, width = image.shape
    size = (max(width // 2, 1), max(height // 2, 1))
    half: NDArray[np.uint8] = cv2.resize(image, size, interpolation=cv2.INTER_AREA)  # type: ignore[assignment]
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
    """Positions of a grid around (x, y); (co, si) is the spacing along the grid's first axis."""
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

"""Image pyramid of a frame: brightness in several sizes, inverse depth, and timing.

The view is also divided into a grid of cells, for weights by region.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, sqrt
from typing import NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel
from vo_service.odometry.direct.parameters import (
    BRIGHTNESS_WEIGHT,
    DARK_BRIGHTNESS,
    DEPTH_NOISE_PER_M,
    MAX_SURFACE_STEP_SHARE,
    MAX_SURFACE_STEP_SIGMAS,
    MIN_DEPTH_SHARE,
    MIN_GAIN,
    MIN_IMAGE_PX,
    POINT_BLOCKS,
)

# Brightness in 1/2, 1/4, 1/8 and 1/16 of the frame's size. The whole size gains nothing: a Kinect's
# colors are interpolated, and its edges are 2 pixels wide. Kernels take this many levels.
NUM_LEVELS = len(POINT_BLOCKS)
# Bounds of the gain of the affine brightness model.
GAIN_RANGE = (MIN_GAIN, 1.0 / MIN_GAIN)
# The grid of cells over the image.
CELL_ROWS, CELL_COLUMNS = 6, 8
NUM_CELLS = CELL_ROWS * CELL_COLUMNS
ALL_STATIC = np.ones(NUM_CELLS, np.bool_)


@dataclass(frozen=True)
class ImageTiming:
    """Times of the rows, relative to the middle row of the color image.

    Attributes:
        readout_s: From the first row to the last, of both images.
        skew_s: Middle row of the depth image after that of the color image.
    """

    readout_s: float
    skew_s: float

    @property
    def is_instant(self) -> bool:
        """Whether all rows of both images have the same time."""
        return self.readout_s == 0.0 and self.skew_s == 0.0


class HasMeanBrightness(Protocol):
    """A view with a known mean brightness, in gray levels."""

    @property
    def mean_brightness(self) -> float: ...


class LevelImages(NamedTuple):
    """Images of one level and the times of their rows, as kernels take them.

    Attributes:
        gray: (h, w) uint8 of the level.
        intrinsics: (4,) fx, fy, cx, cy of the level.
        inverse_depth: (H, W) float32 of the whole size, 1/m; 0 = no reading.
        depth_intrinsics: (4,) of the whole size.
        readout_s: Time from the first row to the last.
        skew_s: Time of the depth image after the color image.
        vignetting: Of the lens, see `VignettingEstimate`.
        depth_noise: Sigma of the inverse depth of a pixel, 1/m.
    """

    gray: NDArray[np.uint8]
    intrinsics: Array
    inverse_depth: NDArray[np.float32]
    depth_intrinsics: Array
    readout_s: float
    skew_s: float
    vignetting: float
    depth_noise: float


@dataclass(frozen=True)
class DepthImage:
    """Depth of a frame.

    Attributes:
        raw: (H, W) uint16 as given by the sensor, 0 = no reading.
        factor: Value of `raw` per meter.
    """

    raw: NDArray[np.uint16]
    factor: float

    @classmethod
    def of(cls, frame: RgbdFrame) -> "DepthImage":
        """Take the depth of a frame."""
        depth_raw = frame.depth_raw.view()
        # One array type to compile: some cameras' arrays are read-only.
        depth_raw.flags.writeable = False
        return cls(depth_raw, float(frame.depth_factor))

    @cached_property
    def inverse(self) -> NDArray[np.float32]:
        """(H, W) inverse depth in 1/m; 0 = no reading."""
        return _invert_depth(self.raw, self.factor)

    @property
    def share(self) -> float:
        """Share of the pixels with a reading."""
        return cv2.countNonZero(self.raw) / self.raw.size

    def without_inverse(self) -> "DepthImage":
        """Return a copy that uses a third of the memory until its inverse depth is needed."""
        return DepthImage(self.raw, self.factor)


@dataclass(frozen=True)
class ImagePyramid:
    """Images of a frame for the alignment.

    Attributes:
        gray: (H / 2, W / 2) uint8 and smaller ones, each half the size of the one before.
        depth: Of the whole size.
        camera: Intrinsics of the whole size.
        shutter: Times of the rows.
        stamp_s: Of the frame.
        vignetting: Of the lens, see `VignettingEstimate`.
        brightness_weight: Relative to depth, see `BrightnessWeight`.
        depth_noise: Sigma of the inverse depth of a pixel, 1/m, see `DepthNoise`.
        point_blocks: Number of blocks along the longer side that give a point each, by level, at
            least as many as gray images.
        body_blocks: (rows, columns) blocks that show the robot's body, see `RobotBody`; None for
            none.
    """

    gray: tuple[NDArray[np.uint8], ...]
    depth: DepthImage
    camera: PinholeCamera
    shutter: ImageTiming
    stamp_s: float
    vignetting: float = 0.0
    brightness_weight: float = BRIGHTNESS_WEIGHT
    depth_noise: float = DEPTH_NOISE_PER_M
    point_blocks: Sequence[int] = POINT_BLOCKS
    body_blocks: NDArray[np.bool_] | None = None

    @cached_property
    def intrinsics(self) -> tuple[Array, ...]:
        """(4,) fx, fy, cx, cy of the whole size, then of each gray image.

        The center of an image's first pixel is (0, 0).
        """
        camera = self.camera
        fx, fy, cx, cy = camera.fx, camera.fy, camera.cx, camera.cy
        scales = [0.5**level for level in range(len(self.gray) + 1)]
        return tuple(
            np.array([[s * fx, s * fy, s * (cx + 0.5) - 0.5, s * (cy + 0.5) - 0.5] for s in scales])
        )

    @cached_property
    def levels(self) -> Sequence[LevelImages]:
        """What kernels take, for each gray image."""
        whole, *halved = self.intrinsics
        return tuple(
            LevelImages(
                gray,
                intrinsics,
                self.depth.inverse,
                whole,
                self.shutter.readout_s,
                self.shutter.skew_s,
                self.vignetting,
                self.depth_noise,
            )
            for gray, intrinsics in zip(self.gray, halved, strict=True)
        )

    @property
    def point_blocks_px(self) -> Sequence[int]:
        """Size of the blocks that give a point each, for each gray image.

        Where little of the view has depth they are smaller, so that it has enough points. One of
        two neighboring pixels is enough: they share their texture.
        """
        sides = [max(gray.shape) for gray in self.gray]
        sizes = [
            ceil(side / blocks) for side, blocks in zip(sides, self.point_blocks, strict=False)
        ]
        scale = sqrt(min(self.depth.share / MIN_DEPTH_SHARE, 1.0))
        return [max(ceil(scale * size), min(size, 2)) for size in sizes]

    def brightness_ratio(self, other: HasMeanBrightness) -> float:
        """Ratio to the brightness of another view, within the bounds of the gain."""
        ratio = (self.mean_brightness + DARK_BRIGHTNESS) / (other.mean_brightness + DARK_BRIGHTNESS)
        return float(min(max(ratio, GAIN_RANGE[0]), GAIN_RANGE[1]))

    @cached_property
    def mean_brightness(self) -> float:
        """Mean of the whole image, gray levels."""
        return cv2.mean(self.gray[-1])[0]


def build_image_pyramid(
    frame: RgbdFrame,
    vignetting: float = 0.0,
    brightness_weight: float = BRIGHTNESS_WEIGHT,
    depth_noise: float = DEPTH_NOISE_PER_M,
    point_blocks: Sequence[int] = POINT_BLOCKS,
    body_blocks: NDArray[np.bool_] | None = None,
) -> ImagePyramid:
    """Build the image pyramid of a frame; see there for the arguments.

    Args:
        frame: The frame.
        vignetting: Of the lens, see `VignettingEstimate`.
        brightness_weight: Relative to depth, see `BrightnessWeight`.
        depth_noise: See `DepthNoise`.
        point_blocks: Numbers of blocks for a keyframe's points, one for each level; at most
            `NUM_LEVELS`.
        body_blocks: See `RobotBody`.
    """
    return ImagePyramid(
        gray=_downscale(frame.gray, len(point_blocks)),
        depth=DepthImage.of(frame),
        camera=frame.camera,
        shutter=ImageTiming(frame.readout_s, frame.skew_s),
        stamp_s=frame.stamp_s,
        vignetting=vignetting,
        brightness_weight=brightness_weight,
        depth_noise=depth_noise,
        point_blocks=point_blocks,
        body_blocks=body_blocks,
    )


def _downscale(gray: NDArray[np.uint8], num_levels: int) -> tuple[NDArray[np.uint8], ...]:
    levels: list[NDArray[np.uint8]] = []
    height, width = gray.shape
    for _ in range(num_levels):
        height, width = max(height // 2, 1), max(width // 2, 1)
        if levels and min(height, width) < MIN_IMAGE_PX:
            break
        last = levels[-1] if levels else gray
        cut = last[: 2 * height, : 2 * width]
        levels.append(cv2.resize(cut, (width, height), interpolation=cv2.INTER_AREA))  # type: ignore[arg-type]
    return tuple(levels)


@kernel
def _invert_depth(depth_raw: NDArray[np.uint16], depth_factor: float) -> NDArray[np.float32]:
    """(H, W) inverse depth, 1/m; holes one pixel wide within a surface are filled.

    Without branches in its loops, and in single precision, so that the compiler vectorizes them.
    """
    height, width = depth_raw.shape
    inverse = np.empty((height, width), np.float32)
    row, filled = np.empty(width, np.float32), np.zeros((3, width), np.float32)
    no_reading = np.zeros(width, np.float32)
    for v in range(height):
        for u in range(width):
            row[u] = inverse_depth(depth_raw[v, u], depth_factor)
        _fill_along_row(row, filled[v % 3])
        if v > 0:
            above, here, below = filled[(v - 2) % 3], filled[(v - 1) % 3], filled[v % 3]
            _fill_across_rows(above, here, below, inverse[v - 1])
    _fill_across_rows(no_reading, filled[(height - 1) % 3], no_reading, inverse[height - 1])
    return inverse


@kernel
def _fill_along_row(row: NDArray[np.float32], filled: NDArray[np.float32]) -> None:
    filled[0], filled[-1] = row[0], row[-1]
    for u in range(1, len(row) - 1):
        filled[u] = _fill_hole(row[u - 1], row[u], row[u + 1])


@kernel
def _fill_across_rows(
    above: NDArray[np.float32],
    row: NDArray[np.float32],
    below: NDArray[np.float32],
    filled: NDArray[np.float32],
) -> None:
    for u in range(len(row)):
        filled[u] = _fill_hole(above[u], row[u], below[u])


@inline_kernel
def _fill_hole(before: np.float32, pixel: np.float32, after: np.float32) -> np.float32:
    """Inverse depth of a pixel; without a reading the mean of its neighbors on one surface."""
    zero = np.float32(0.0)
    max_step = np.float32(MAX_SURFACE_STEP_SHARE) * max(before, after)
    is_hole = (pixel == zero) & (before > zero) & (after > zero)
    is_filled = is_hole & (abs(before - after) <= max_step)
    return np.float32(0.5) * (before + after) if is_filled else pixel


@inline_kernel
def inverse_depth(depth_raw: int, depth_factor: float) -> np.float32:
    """Inverse depth in 1/m of a pixel, with single precision; 0 without a reading."""
    return np.float32(depth_factor) / np.float32(depth_raw) if depth_raw > 0 else np.float32(0.0)


@inline_kernel
def surface_step(inverse_depth: float, depth_noise: float) -> float:
    """Largest difference of inverse depths within a surface, 1/m.

    Args:
        inverse_depth: Of the surface, 1/m.
        depth_noise: Of a pixel, 1/m.
    """
    return MAX_SURFACE_STEP_SHARE * inverse_depth + MAX_SURFACE_STEP_SIGMAS * depth_noise


@inline_kernel
def cell_index(u_share: float, v_share: float) -> int:
    """Index of the cell at a position, given as shares of the image's width and height."""
    row = min(max(int(v_share * CELL_ROWS), 0), CELL_ROWS - 1)
    column = min(max(int(u_share * CELL_COLUMNS), 0), CELL_COLUMNS - 1)
    return row * CELL_COLUMNS + column

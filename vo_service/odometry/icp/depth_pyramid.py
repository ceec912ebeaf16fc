"""Pyramid of inverse depth, 1/z.

The Kinect measures disparity, so the noise of 1/z is the same near and far; and over a plane 1/z is
linear in the pixel, so that the mean of neighbors lies on the plane, unlike a mean of z.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.jit import inline_kernel, kernel

NUM_LEVELS = 3
# Readings that differ by more (1/m) are of two surfaces; the nearer one is used.
MAX_STEP_PER_M = 0.02


@dataclass(frozen=True)
class DepthLevel:
    """One level of the pyramid.

    Attributes:
        inverse_depth: (H, W) float32, 1/m; 0 = no reading.
        camera: Intrinsics of this size.
        scale: Size of a pixel in pixels of the whole image.
    """

    inverse_depth: NDArray[np.float32]
    camera: PinholeCamera
    scale: int

    @cached_property
    def intrinsics(self) -> NDArray[np.float64]:
        """(4,) fx, fy, cx, cy."""
        return np.array([self.camera.fx, self.camera.fy, self.camera.cx, self.camera.cy])


@dataclass(frozen=True)
class DepthPyramid:
    """Levels of a frame from fine to coarse, and its stamp."""

    levels: tuple[DepthLevel, ...]
    stamp_s: float


def build_depth_pyramid(frame: RgbdFrame) -> DepthPyramid:
    """Build levels of 1/2, 1/4 and 1/8 of the frame's size."""
    camera = _halve_intrinsics(frame.camera)
    inverse_depth = invert_and_halve_depth(frame.depth_m)
    levels = [DepthLevel(inverse_depth, camera, 2)]
    while len(levels) < NUM_LEVELS:
        camera, inverse_depth = _halve_intrinsics(camera), halve_inverse_depth(inverse_depth)
        levels.append(DepthLevel(inverse_depth, camera, 2 * levels[-1].scale))
    return DepthPyramid(tuple(levels), frame.stamp_s)


def _halve_intrinsics(camera: PinholeCamera) -> PinholeCamera:
    """Intrinsics of an image of half the size; the center of the first pixel stays (0, 0)."""
    return PinholeCamera(
        camera.width // 2,
        camera.height // 2,
        camera.fx / 2,
        camera.fy / 2,
        (camera.cx - 0.5) / 2,
        (camera.cy - 0.5) / 2,
    )


@kernel
def invert_and_halve_depth(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Inverse depth (H // 2, W // 2) of a depth image (H, W)."""
    height, width = depth_m.shape[0] // 2, depth_m.shape[1] // 2
    halved = np.empty((height, width), np.float32)
    rows = np.empty((2, 2 * width), np.float32)
    for v in range(height):
        for half in range(2):
            for u in range(2 * width):
                z = depth_m[2 * v + half, u]
                rows[half, u] = np.float32(1.0) / z if z > 0 else np.float32(0.0)
        above, below = rows[0], rows[1]
        for u in range(width):
            halved[v, u] = _mean_of_nearest_surface(
                above[2 * u], above[2 * u + 1], below[2 * u], below[2 * u + 1]
            )
    return halved


@kernel
def halve_inverse_depth(inverse_depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Halve an image of inverse depth, to (H // 2, W // 2)."""
    height, width = inverse_depth.shape[0] // 2, inverse_depth.shape[1] // 2
    halved = np.empty((height, width), np.float32)
    for v in range(height):
        above, below = inverse_depth[2 * v], inverse_depth[2 * v + 1]
        for u in range(width):
            halved[v, u] = _mean_of_nearest_surface(
                above[2 * u], above[2 * u + 1], below[2 * u], below[2 * u + 1]
            )
    return halved


@inline_kernel
def _mean_of_nearest_surface(
    a: np.float32, b: np.float32, c: np.float32, d: np.float32
) -> np.float32:
    """Mean of the readings of the nearest surface; 0 without a reading."""
    lowest = max(max(a, b), max(c, d)) - np.float32(MAX_STEP_PER_M)
    lowest = max(lowest, np.float32(1e-6))
    total = np.float32(0.0)
    count = np.float32(0.0)
    for w in (a, b, c, d):
        if w >= lowest:
            total += w
            count += np.float32(1.0)
    return total / count if count > 0 else np.float32(0.0)

"""Images are halved before the odometry if they are large, or if their depth is a sparse grid.

The odometry takes as long for large images as for a Kinect's. Depth is a grid with holes where a
smaller depth image is registered to a larger color image, pixel by pixel.
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera, RgbdFrame
from drivers.core.jit import kernel
from vo_service.odometry.direct.image_pyramid import NUM_LEVELS, DepthImage
from vo_service.odometry.direct.parameters import (
    MAX_IMAGE_PX,
    MAX_SURFACE_STEP_SHARE,
    MIN_COVERAGE_GAIN,
    MIN_IMAGE_PX,
)
from vo_service.types.estimate import Estimate
from vo_service.types.odometry import Odometry


class HalvingOdometry:
    """Runs an odometry on images that are at most `MAX_IMAGE_PX` long, and whose depth is dense."""

    def __init__(self, odometry: Odometry) -> None:
        self._odometry = odometry
        self._sensor: tuple[str, PinholeCamera] | None = None
        self._is_tracking = False
        self._halvings = 0

    def estimate(self, frame: RgbdFrame) -> Estimate:
        """Estimate the pose; see `Odometry`. Pixels are those of the frame."""
        sensor = frame.serial, frame.camera
        # The size is kept once a frame of the sensor had a pose.
        if sensor != self._sensor or not self._is_tracking:
            self._sensor, self._is_tracking = sensor, False
            self._halvings = count_halvings(frame)
        for _ in range(self._halvings):
            frame = halve(frame)
        estimate = self._odometry.estimate(frame)
        self._is_tracking |= estimate.ok
        scale = 2**self._halvings
        return estimate if scale == 1 else replace(estimate, debug=estimate.debug.scaled(scale))


def halve_as_needed(frame: RgbdFrame) -> RgbdFrame:
    """Return a frame as the odometry takes it, which starts with this frame."""
    for _ in range(count_halvings(frame)):
        frame = halve(frame)
    return frame


def count_halvings(frame: RgbdFrame) -> int:
    """How often to halve a frame: until it is small, and as long as the depth covers more by it."""
    halved, count = halve(frame), 0
    while max(frame.depth_raw.shape) > MAX_IMAGE_PX or (
        min(halved.depth_raw.shape) >= 2 ** (NUM_LEVELS - 1) * MIN_IMAGE_PX
        and _depth_coverage(halved) > MIN_COVERAGE_GAIN * _depth_coverage(frame)
    ):
        frame, halved, count = halved, halve(halved), count + 1
    return count


def _depth_coverage(frame: RgbdFrame) -> float:
    """Share of the image with depth, after narrow holes are filled."""
    inverse_depth = DepthImage.of(frame).inverse
    return np.count_nonzero(inverse_depth) / inverse_depth.size


def halve(frame: RgbdFrame) -> RgbdFrame:
    """Return a frame of half the size; (u, v) of it is (2 u, 2 v) of the frame.

    Brightness is the weighted mean around every second pixel, depth that of this pixel: a mean of
    depths would be between two surfaces. Without a reading it is that of the surface next to it.
    """
    camera = frame.camera
    return replace(
        frame,
        color_bgr=np.asarray(cv2.pyrDown(frame.color_bgr), np.uint8),
        depth_raw=_halve_depth(DepthImage.of(frame).raw),
        camera=PinholeCamera(
            (camera.width + 1) // 2,
            (camera.height + 1) // 2,
            camera.fx / 2,
            camera.fy / 2,
            camera.cx / 2,
            camera.cy / 2,
        ),
    )


@kernel
def _halve_depth(depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Every second pixel of (H, W); without a reading the mean of the nearest surface around it."""
    height, width = depth_raw.shape
    halved = np.empty(((height + 1) // 2, (width + 1) // 2), np.uint16)
    for row in range(halved.shape[0]):
        for column in range(halved.shape[1]):
            reading = depth_raw[2 * row, 2 * column]
            if reading == 0:
                reading = _mean_of_nearest_surface(depth_raw, 2 * row, 2 * column)
            halved[row, column] = reading
    return halved


@kernel
def _mean_of_nearest_surface(depth_raw: NDArray[np.uint16], row: int, column: int) -> int:
    """Mean depth of the nearest surface among the neighbors of a pixel; 0 without a reading."""
    height, width = depth_raw.shape
    top, bottom = max(row - 1, 0), min(row + 2, height)
    left, right = max(column - 1, 0), min(column + 2, width)
    nearest = np.inf
    for v in range(top, bottom):
        for u in range(left, right):
            if depth_raw[v, u] > 0:
                nearest = min(nearest, float(depth_raw[v, u]))
    farthest, total, count = nearest / (1.0 - MAX_SURFACE_STEP_SHARE), 0.0, 0
    for v in range(top, bottom):
        for u in range(left, right):
            if 0 < depth_raw[v, u] <= farthest:
                total += float(depth_raw[v, u])
                count += 1
    return int(total / count + 0.5) if count > 0 else 0

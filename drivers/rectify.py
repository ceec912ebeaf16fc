"""Undistortion of images, and registration of depth to the color camera."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import DepthCameraCalibration
from drivers.camera import PinholeCamera
from drivers.core import InputError
from drivers.core.geometry import Array


class Undistorter:
    """Converts a camera's images to those of the pinhole camera with the same intrinsics.

    Args:
        camera: The camera.
        distortion: k1 k2 p1 p2 k3; all zeros return images unchanged.
    """

    def __init__(self, camera: PinholeCamera, distortion: Sequence[float]) -> None:
        self._is_needed = any(distortion)
        if not self._is_needed:
            return
        coefficients = np.array(distortion, dtype=np.float64)
        size = (camera.width, camera.height)
        columns, rows = cv2.initUndistortRectifyMap(
            camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1
        )
        # Fixed-point maps are several times faster than float, and bit-identical on all machines.
        self._bilinear_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2)
        self._nearest_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2, nninterpolation=True)

    def undistort_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort (height, width, 3) uint8 bilinearly; black outside the original image."""
        if not self._is_needed:
            return image
        return cv2.remap(image, *self._bilinear_maps, cv2.INTER_LINEAR)  # type: ignore[return-value]

    def undistort_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistort (height, width) uint16 without interpolation; 0 outside the original image."""
        if not self._is_needed:
            return image
        return cv2.remap(image, *self._nearest_maps, cv2.INTER_NEAREST)  # type: ignore[return-value]


# `cv2.registerDepth` interprets uint16 depth as millimeters, whatever its unit.
MILLIMETERS_PER_METER = 1000.0
MAX_DEPTH_VALUE = 65535
_ZERO_DISTORTION = np.zeros(5)


class SoftwareRegistration:
    """Registers depth to the color camera; of several readings for a pixel the nearest is kept.

    Values stay in the sensor's own unit. The attribute `depth_factor` is the value per true meter,
    so it includes the calibration's scale. Pixels without a reading (occluded, or outside the
    depth camera's view) are 0. If the color camera's pixels are finer, a reading fills all that
    it covers.

    Args:
        color: The undistorted color camera.
        depth: The depth camera.
        depth_factor: The sensor's value per meter.

    Raises:
        InputError: The two cameras do not look in the same direction.
    """

    def __init__(
        self, color: PinholeCamera, depth: DepthCameraCalibration, depth_factor: float
    ) -> None:
        self.depth_factor = depth_factor / depth.scale
        self._undistorter = Undistorter(depth.pinhole, depth.distortion)
        self._depth_K, self._color_K = depth.pinhole.K, color.K
        # OpenCV 5.0 writes out of bounds if the result is smaller than the depth image.
        self._output_size = (max(color.width, depth.width), max(color.height, depth.height))
        self._rows, self._columns = slice(color.height), slice(color.width)
        self._needs_dilation = color.fx > depth.fx or color.fy > depth.fy
        self._T_color_depth = depth.T_color_depth.matrix
        # OpenCV takes the values for millimeters, so the translation is in the same unit.
        self._T_color_depth[:3, 3] *= self.depth_factor / MILLIMETERS_PER_METER
        self._min_value, self._max_value = _usable_range(depth.pinhole, self._T_color_depth)

    def register(self, depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Map the depth camera's (height, width) uint16 image to the color camera's; 0 = none."""
        undistorted = self._undistorter.undistort_depth(depth_raw)
        is_usable = cv2.inRange(undistorted, self._min_value, self._max_value)
        usable = cv2.bitwise_and(undistorted, undistorted, mask=is_usable)
        registered: NDArray[np.uint16] = cv2.registerDepth(
            self._depth_K,
            self._color_K,
            _ZERO_DISTORTION,
            self._T_color_depth,
            usable,
            self._output_size,
            depthDilation=self._needs_dilation,
        )  # type: ignore[assignment]
        return np.ascontiguousarray(registered[self._rows, self._columns])


def _usable_range(depth: PinholeCamera, T_color_depth: Array) -> tuple[int, int]:
    """Return the smallest and largest reading that is in front of the color camera and in 16 bits.

    OpenCV lets other readings wrap around.
    """
    u, v = np.meshgrid((0, depth.width - 1), (0, depth.height - 1))
    rays = np.stack([(u - depth.cx) / depth.fx, (v - depth.cy) / depth.fy, np.ones_like(u)])
    # Growth of the depth in the color camera per unit read; its extremes are at the corners.
    growth = np.tensordot(T_color_depth[2, :3], rays, axes=1)
    if growth.min() <= 0.1:
        raise InputError(
            "camera file: [depth] T_color_depth turns the depth camera away from the color "
            "camera; it must map depth camera coordinates to the color camera's"
        )
    offset = T_color_depth[2, 3] * MILLIMETERS_PER_METER
    nearest = max(0, math.floor(-offset / growth.min())) + 1
    farthest = math.floor((MAX_DEPTH_VALUE - offset) / growth.max())
    return nearest, min(MAX_DEPTH_VALUE, farthest)

"""Lens distortion is taken out once, in the driver; behind it every camera is a pinhole."""

import math
from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.calibration import DepthCameraCalibration
from drivers.camera import PinholeCamera
from drivers.core.errors import InputError
from drivers.core.geometry import Array


class Undistorter(Protocol):
    """Makes the images of one camera those of the pinhole with the same intrinsics."""

    def undistort_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(height, width, 3) uint8, interpolated bilinearly; black where nothing was seen."""
        ...

    def undistort_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(height, width) uint16, the nearest pixel's own reading; 0 where nothing was seen."""
        ...


def make_undistorter(camera: PinholeCamera, distortion: Sequence[float]) -> Undistorter:
    """For distortion k1 k2 p1 p2 k3 (OpenCV's order); without any, images pass as they are."""
    if any(distortion):
        return _RemapUndistorter(camera, distortion)
    return _IdentityUndistorter()


class _IdentityUndistorter:
    def undistort_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return image

    def undistort_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        return image


class _RemapUndistorter:
    def __init__(self, camera: PinholeCamera, distortion: Sequence[float]) -> None:
        coefficients = np.array(distortion, dtype=np.float64)
        size = (camera.width, camera.height)
        columns, rows = cv2.initUndistortRectifyMap(
            camera.K, coefficients, np.eye(3), camera.K, size, cv2.CV_32FC1
        )
        # Fixed point: several times faster than float maps, and the same bits on every machine.
        self._bilinear_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2)
        self._nearest_maps = cv2.convertMaps(columns, rows, cv2.CV_16SC2, nninterpolation=True)

    def undistort_color(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return cv2.remap(image, *self._bilinear_maps, cv2.INTER_LINEAR)  # type: ignore[return-value]

    def undistort_depth(self, image: NDArray[np.uint16]) -> NDArray[np.uint16]:
        return cv2.remap(image, *self._nearest_maps, cv2.INTER_NEAREST)  # type: ignore[return-value]


# `cv2.registerDepth` takes uint16 depth for millimetres, whatever its unit.
MILLIMETRES_PER_METRE = 1000.0
MAX_DEPTH_VALUE = 65535
_ZERO_DISTORTION = np.zeros(5)


class SoftwareRegistration:
    """Moves each reading to where the color camera sees it, the nearest in front.

    Values stay in the sensor's own unit; `depth_factor` of the result is value per true metre, so
    it holds the table's scale. Where no reading arrives (in the shadow of something near, outside
    the depth camera's view) the result is 0. Where the color camera's pixels are the finer ones,
    a reading covers all that it spans.
    """

    def __init__(
        self, color: PinholeCamera, depth: DepthCameraCalibration, depth_factor: float
    ) -> None:
        """`color` is the undistorted color camera, `depth_factor` the sensor's value per metre.

        Raises InputError if the two cameras do not look the same way.
        """
        self.depth_factor = depth_factor / depth.scale
        self._undistorter = make_undistorter(depth.pinhole, depth.distortion)
        self._depth_K, self._color_K = depth.pinhole.K, color.K
        # OpenCV 5.0 writes beyond its memory where the result is smaller than the depth image.
        self._output_size = (max(color.width, depth.width), max(color.height, depth.height))
        self._rows, self._columns = slice(color.height), slice(color.width)
        self._needs_dilation = color.fx > depth.fx or color.fy > depth.fy
        self._T_color_depth = depth.T_color_depth.matrix
        # Everything is linear in length: with the offset in units of depth, so is the result.
        self._T_color_depth[:3, 3] *= self.depth_factor / MILLIMETRES_PER_METRE
        self._min_value, self._max_value = _usable_range(depth.pinhole, self._T_color_depth)

    def register(self, depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(height, width) uint16 of the depth camera to that of the color camera; 0 is none."""
        seen = self._undistorter.undistort_depth(depth_raw)
        is_usable = cv2.inRange(seen, self._min_value, self._max_value)
        usable = cv2.bitwise_and(seen, seen, mask=is_usable)
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
    """The least and the greatest reading that stays in front of the color camera and in 16 bits.

    OpenCV lets others wrap around.
    """
    u, v = np.meshgrid((0, depth.width - 1), (0, depth.height - 1))
    rays = np.stack([(u - depth.cx) / depth.fx, (v - depth.cy) / depth.fy, np.ones_like(u)])
    # Depth in the color camera grows by so much per depth read; a plane's extremes are corners.
    growth = np.tensordot(T_color_depth[2, :3], rays, axes=1)
    if growth.min() <= 0.1:
        raise InputError(
            "camera file: [depth] T_color_depth turns the depth camera away from the color "
            "camera; it must map depth camera coordinates to the color camera's"
        )
    offset = T_color_depth[2, 3] * MILLIMETRES_PER_METRE
    nearest = max(0, math.floor(-offset / growth.min())) + 1
    farthest = math.floor((MAX_DEPTH_VALUE - offset) / growth.max())
    return nearest, min(MAX_DEPTH_VALUE, farthest)

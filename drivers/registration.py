"""Depth of a camera of its own, made depth of the colour camera: registration in software."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera
from drivers.camera_file import DepthTable
from drivers.errors import InputError
from drivers.geometry import Array
from drivers.undistort import undistorter

# `cv2.registerDepth` takes uint16 depth for millimetres, whatever its unit.
UNITS_PER_METRE = 1000.0
LARGEST = 65535
NO_DISTORTION = np.zeros(5)


class SoftwareRegistration:
    """Moves each reading to where the colour camera sees it, the nearest in front.

    Values stay in the sensor's own unit; `depth_factor` of the result is value per true metre, so
    it holds the table's scale. Where no reading arrives (in the shadow of something near, outside
    the depth camera's view) the result is 0. Where the colour camera's pixels are the finer ones,
    a reading covers all that it spans.
    """

    def __init__(self, colour: PinholeCamera, depth: DepthTable, depth_factor: float) -> None:
        """`colour` is the undistorted colour camera, `depth_factor` the sensor's value per metre.

        Raises InputError if the two cameras do not look the same way.
        """
        self.depth_factor = depth_factor / depth.scale
        self._lens = undistorter(depth.pinhole, depth.distortion)
        self._depth_K, self._colour_K = depth.pinhole.K, colour.K
        # OpenCV 5.0 writes beyond its memory where the result is smaller than the depth image.
        self._plane = (max(colour.width, depth.width), max(colour.height, depth.height))
        self._rows, self._columns = slice(colour.height), slice(colour.width)
        self._magnifies = colour.fx > depth.fx or colour.fy > depth.fy
        self._T = depth.T_color_depth.matrix
        # Everything is linear in length: with the offset in units of depth, so is the result.
        self._T[:3, 3] *= self.depth_factor / UNITS_PER_METRE
        self._nearest, self._farthest = _usable(depth.pinhole, self._T)

    def register(self, depth_raw: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """(height, width) uint16 of the depth camera to that of the colour camera; 0 is none."""
        seen = self._lens.depth(depth_raw)
        is_usable = cv2.inRange(seen, self._nearest, self._farthest)
        usable = cv2.bitwise_and(seen, seen, mask=is_usable)
        registered: NDArray[np.uint16] = cv2.registerDepth(
            self._depth_K,
            self._colour_K,
            NO_DISTORTION,
            self._T,
            usable,
            self._plane,
            depthDilation=self._magnifies,
        )  # type: ignore[assignment]
        return np.ascontiguousarray(registered[self._rows, self._columns])


def _usable(depth: PinholeCamera, T_colour_depth: Array) -> tuple[int, int]:
    """The least and the greatest reading that stays in front of the colour camera and in 16 bits.

    OpenCV lets others wrap around.
    """
    u, v = np.meshgrid((0, depth.width - 1), (0, depth.height - 1))
    rays = np.stack([(u - depth.cx) / depth.fx, (v - depth.cy) / depth.fy, np.ones_like(u)])
    # Depth in the colour camera grows by so much per depth read; a plane's extremes are corners.
    growth = np.tensordot(T_colour_depth[2, :3], rays, axes=1)
    if growth.min() <= 0.1:
        raise InputError(
            "camera file: [depth] T_color_depth turns the depth camera away from the colour "
            "camera; it must map depth camera coordinates to the colour camera's"
        )
    offset = T_colour_depth[2, 3] * UNITS_PER_METRE
    nearest = max(0, math.floor(-offset / growth.min())) + 1
    farthest = math.floor((LARGEST - offset) / growth.max())
    return nearest, min(LARGEST, farthest)

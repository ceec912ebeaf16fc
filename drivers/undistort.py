"""Lens distortion is taken out once, in the driver; behind it every camera is a pinhole."""

from collections.abc import Sequence
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import PinholeCamera


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

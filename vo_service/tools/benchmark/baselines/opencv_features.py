"""OpenCV's SIFT and ORB in the place of SURF: the features differ, all the rest is ours."""

from collections.abc import Callable
from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.surf import Features
from vo_service.odometry.surf.odometry import SurfOdometry
from vo_service.odometry.surf.parameters import SurfParameters

# Lowe's ratio, on the distance that is each method's own: ORB's is the number of bits that
# differ, which is the square of the distance between vectors of 0 and 1.
MATCH_RATIO = 0.8


class OpenCvExtractor:
    """Descriptors of OpenCV as whole numbers in float32; bits become one number each."""

    def __init__(
        self, create: Callable[[int], cv2.Feature2D], count: int, binary: bool = False
    ) -> None:
        self._create = create
        self._binary = binary
        self.count = count

    @property
    def count(self) -> int:
        """Features to find at most."""
        return self._count

    @count.setter
    def count(self, count: int) -> None:
        self._count = count
        self._detector = self._create(count)

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Features of a (H, W) image, in OpenCV's order. All signs are +1: nothing is left out."""
        keypoints, found = self._detector.detectAndCompute(gray, None)
        n = len(keypoints)
        size = self._detector.descriptorSize()
        table = np.asarray(found) if n else np.empty((0, size))
        angle_rad = np.radians([k.angle for k in keypoints])
        return Features(
            position_px=np.array([k.pt for k in keypoints], np.float32).reshape(-1, 2),
            scale_px=np.array([k.size for k in keypoints], np.float32),
            direction=np.column_stack([np.cos(angle_rad), np.sin(angle_rad)]).astype(np.float32),
            response=np.array([k.response for k in keypoints], np.float32),
            sign=np.ones(n, np.float32),
            descriptor=self._to_vectors(table),
        )

    def _to_vectors(self, table: NDArray[np.generic]) -> NDArray[np.float32]:
        if self._binary:
            return np.unpackbits(table.astype(np.uint8), axis=1).astype(np.float32)
        return table.astype(np.float32)


def sift_odometry(count: int, stopwatch: StageTimer) -> SurfOdometry:
    """`SurfOdometry`, fed by SIFT (Lowe 2004)."""
    extractor = OpenCvExtractor(cv2.SIFT_create, count)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=MATCH_RATIO), timer=stopwatch)


def orb_odometry(count: int, stopwatch: StageTimer) -> SurfOdometry:
    """`SurfOdometry`, fed by ORB (Rublee et al. 2011)."""
    extractor = OpenCvExtractor(cv2.ORB_create, count, binary=True)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=sqrt(MATCH_RATIO)), timer=stopwatch)

"""OpenCV's SIFT and ORB in our feature-based odometry, in place of SURF."""

from collections.abc import Callable
from math import sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from vo_service.odometry.features import SurfParameters
from vo_service.odometry.profiling import StageTimer
from vo_service.odometry.surf import Features
from vo_service.odometry.surf.odometry import SurfOdometry

# Lowe's ratio, for each method's own distance. ORB's is the number of different bits, which is
# the square of the distance between vectors of 0 and 1.
MATCH_RATIO = 0.8


class OpenCvExtractor:
    """Extractor of OpenCV features; descriptors are float32 vectors, with one element per bit."""

    def __init__(
        self, create: Callable[[int], cv2.Feature2D], count: int, binary: bool = False
    ) -> None:
        """Set the method.

        Args:
            create: Makes a detector with a maximum number of features.
            count: Maximum number of features.
            binary: Whether descriptors are bits.
        """
        self._create = create
        self._binary = binary
        self.count = count

    @property
    def count(self) -> int:
        """Maximum number of features."""
        return self._count

    @count.setter
    def count(self, count: int) -> None:
        self._count = count
        self._detector = self._create(count)

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Extract features of a (H, W) image. All signs are +1, so all features are compared."""
        keypoints, descriptors = self._detector.detectAndCompute(gray, None)
        n = len(keypoints)
        size = self._detector.descriptorSize()
        table = np.asarray(descriptors) if n else np.empty((0, size))
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
    """Make a `SurfOdometry` with SIFT features (Lowe 2004)."""
    extractor = OpenCvExtractor(cv2.SIFT_create, count)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=MATCH_RATIO), timer=stopwatch)


def orb_odometry(count: int, stopwatch: StageTimer) -> SurfOdometry:
    """Make a `SurfOdometry` with ORB features (Rublee et al. 2011)."""
    extractor = OpenCvExtractor(cv2.ORB_create, count, binary=True)  # type: ignore[attr-defined]
    return SurfOdometry(extractor, SurfParameters(match_ratio=sqrt(MATCH_RATIO)), timer=stopwatch)

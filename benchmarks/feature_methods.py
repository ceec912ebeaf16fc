"""SURF, SIFT and ORB behind one function type, so that all are measured in the same way."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.image_transforms import Gray
from vo_service.odometry.surf import SurfExtractor

COUNT = 1000


@dataclass(frozen=True)
class FeatureSet:
    """Features of one image.

    Attributes:
        position_px: (N, 2) float64, (x, y).
        scale_px: (N,) float64, in the method's own unit.
        descriptor: (N, D), float32 for Euclidean distance or uint8 for Hamming distance.
    """

    position_px: NDArray[np.float64]
    scale_px: NDArray[np.float64]
    descriptor: NDArray[Any]

    def __len__(self) -> int:
        return len(self.position_px)


FeatureMethod = Callable[[Gray], FeatureSet]


def make_surf(upright: bool = False) -> FeatureMethod:
    """Make our SURF with the strongest 1000 features."""
    extractor = SurfExtractor(COUNT, upright)

    def extract(image: Gray) -> FeatureSet:
        features = extractor.extract(image)
        return FeatureSet(
            features.position_px.astype(np.float64),
            features.scale_px.astype(np.float64),
            features.descriptor,
        )

    return extract


def make_opencv_method(detector: cv2.Feature2D) -> FeatureMethod:
    """Make a method from one of OpenCV's detectors."""

    def extract(image: Gray) -> FeatureSet:
        keypoints, descriptors = detector.detectAndCompute(image, np.ones_like(image))
        position_px = np.array([k.pt for k in keypoints], np.float64).reshape(-1, 2)
        scale_px = np.array([k.size for k in keypoints], np.float64)
        return FeatureSet(position_px, scale_px, np.asarray(descriptors))

    return extract


def make_all_methods() -> dict[str, FeatureMethod]:
    """Make the methods of the table, by name."""
    return {
        "SURF": make_surf(),
        "SIFT": make_opencv_method(cv2.SIFT_create(COUNT)),  # type: ignore[attr-defined]
        "ORB": make_opencv_method(cv2.ORB_create(COUNT)),  # type: ignore[attr-defined]
    }


def match(original: FeatureSet, changed: FeatureSet, ratio: float) -> NDArray[np.int64]:
    """Match descriptors by brute force and the ratio test (Lowe 2004, Section 7.1).

    Returns:
        Pairs (M, 2) of indices of nearest neighbors.
    """
    if len(original) == 0 or len(changed) < 2:
        return np.empty((0, 2), np.int64)
    is_binary = original.descriptor.dtype == np.uint8
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if is_binary else cv2.NORM_L2)
    two_nearest = matcher.knnMatch(original.descriptor, changed.descriptor, k=2)
    pairs = [(a.queryIdx, a.trainIdx) for a, b in two_nearest if a.distance < ratio * b.distance]
    return np.array(pairs, np.int64).reshape(-1, 2)

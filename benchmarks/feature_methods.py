"""SURF, SIFT and ORB behind one call, so that each is measured in the same way."""

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

    position_px  (N, 2) float64, (x, y)
    scale_px     (N,) float64, in a unit of the method's own
    descriptor   (N, D), float32 to compare by distance or uint8 to compare by differing bits
    """

    position_px: NDArray[np.float64]
    scale_px: NDArray[np.float64]
    descriptor: NDArray[Any]

    def __len__(self) -> int:
        return len(self.position_px)


FeatureMethod = Callable[[Gray], FeatureSet]


def make_surf(upright: bool = False) -> FeatureMethod:
    """Ours, the strongest 1000."""
    extractor = SurfExtractor(COUNT, upright)

    def extract(image: Gray) -> FeatureSet:
        found = extractor.extract(image)
        return FeatureSet(
            found.position_px.astype(np.float64),
            found.scale_px.astype(np.float64),
            found.descriptor,
        )

    return extract


def make_opencv_method(detector: cv2.Feature2D) -> FeatureMethod:
    """One of OpenCV's."""

    def extract(image: Gray) -> FeatureSet:
        keypoints, descriptors = detector.detectAndCompute(image, np.ones_like(image))
        position_px = np.array([k.pt for k in keypoints], np.float64).reshape(-1, 2)
        scale_px = np.array([k.size for k in keypoints], np.float64)
        return FeatureSet(position_px, scale_px, np.asarray(descriptors))

    return extract


def make_all_methods() -> dict[str, FeatureMethod]:
    """The methods of the table, each ready to use."""
    return {
        "SURF": make_surf(),
        "SIFT": make_opencv_method(cv2.SIFT_create(COUNT)),  # type: ignore[attr-defined]
        "ORB": make_opencv_method(cv2.ORB_create(COUNT)),  # type: ignore[attr-defined]
    }


def match(original: FeatureSet, changed: FeatureSet, ratio: float) -> NDArray[np.int64]:
    """Pairs (M, 2) of indices: nearest descriptor, where the second nearest is further by 1/ratio.

    Lowe 2004, Section 7.1, by brute force, the same for every method.
    """
    if len(original) == 0 or len(changed) < 2:
        return np.empty((0, 2), np.int64)
    is_binary = original.descriptor.dtype == np.uint8
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING if is_binary else cv2.NORM_L2)
    two_nearest = matcher.knnMatch(original.descriptor, changed.descriptor, k=2)
    pairs = [(a.queryIdx, a.trainIdx) for a, b in two_nearest if a.distance < ratio * b.distance]
    return np.array(pairs, np.int64).reshape(-1, 2)

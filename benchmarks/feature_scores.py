"""Features of SURF, SIFT and ORB, and their repeatability and matching score under a homography.

The scores follow Mikolajczyk and Schmid, "A Performance Evaluation of Local Descriptors" (PAMI 27,
2005), with points and scales instead of overlapping ellipses.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.image_transforms import Gray
from drivers.core.geometry import Array
from vo_service.odometry.surf import SurfExtractor

COUNT = 1000
MAX_REPEAT_ERROR_PX = 2.0
MAX_CORRECT_ERROR_PX = 3.0
MAX_SCALE_RATIO = 1.5
MATCH_RATIO = 0.8


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


def _match(original: FeatureSet, changed: FeatureSet, ratio: float) -> NDArray[np.int64]:
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


@dataclass(frozen=True)
class FeatureScore:
    """Scores of one image's features under one transform. Distances are pixels of the original.

    Attributes:
        possible: Features that are inside both images: the smaller count of the two.
        repeated: Features repeated within 2 px at a scale within a factor of 1.5.
        matches: Matches that pass the ratio test.
        errors_px: (correct,) distances of the matches within 3 px of their true position.
    """

    max_repeatable: int
    repeated: int
    matches: int
    errors_px: Array

    @property
    def correct(self) -> int:
        """Number of correct matches."""
        return len(self.errors_px)


def score_features(
    original: FeatureSet, changed: FeatureSet, H: Array, size: tuple[int, int]
) -> FeatureScore:
    """Compare the features of an image, (width, height), with those of its transformed version.

    `H` is the homography (3, 3) from pixels of the original to pixels of the transformed image.
    """
    seen_again = is_inside(transform_points(H, original.position_px), size)
    back_px = transform_points(np.asarray(np.linalg.inv(H), np.float64), changed.position_px)
    is_of_original = is_inside(back_px, size)
    back_scale = changed.scale_px / scale_at(H, back_px)
    repeated = _count_repeated(
        original.position_px[seen_again],
        original.scale_px[seen_again],
        back_px[is_of_original],
        back_scale[is_of_original],
    )
    pairs = _match(original, changed, MATCH_RATIO)
    away_px = original.position_px[pairs[:, 0]] - back_px[pairs[:, 1]]
    errors_px = np.asarray(np.linalg.norm(away_px, axis=1), np.float64)
    return FeatureScore(
        max_repeatable=int(min(seen_again.sum(), is_of_original.sum())),
        repeated=repeated,
        matches=len(pairs),
        errors_px=errors_px[errors_px <= MAX_CORRECT_ERROR_PX],
    )


def transform_points(H: Array, points_px: Array) -> Array:
    """Transform pixels (N, 2) by a homography."""
    if len(points_px) == 0:
        return points_px
    return np.asarray(cv2.perspectiveTransform(points_px[None], H)[0], np.float64)


def scale_at(H: Array, points_px: Array) -> Array:
    """Local scale (N,) of a homography at pixels (N, 2): sqrt |det J|."""
    w = points_px @ H[2, :2] + H[2, 2]
    return np.asarray(np.sqrt(np.abs(np.linalg.det(H) / w**3)))


def is_inside(points_px: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which pixels (N, 2) are inside an image of (width, height)."""
    return np.asarray(np.all((points_px >= 0) & (points_px <= np.array(size) - 1.0), axis=1))


def _count_repeated(a_px: Array, a_scale: Array, b_px: Array, b_scale: Array) -> int:
    """Count features with a counterpart of similar position and scale; the smaller count of both.

    The assignment is not one to one: two features on the same spot both count.
    """
    if len(a_px) == 0 or len(b_px) == 0:
        return 0
    distance_px = np.linalg.norm(a_px[:, None] - b_px[None], axis=2)
    scale_step = np.abs(np.log(a_scale[:, None] / b_scale[None]))
    is_same = (distance_px <= MAX_REPEAT_ERROR_PX) & (scale_step < np.log(MAX_SCALE_RATIO))
    return int(min(is_same.any(axis=1).sum(), is_same.any(axis=0).sum()))

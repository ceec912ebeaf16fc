"""How well features are found again and recognised, where the truth is a homography.

Repeatability and matching score as Mikolajczyk and Schmid, "A Performance Evaluation of Local
Descriptors" (PAMI 27, 2005), with points and scales instead of overlapping ellipses.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.feature_methods import FeatureSet, match
from drivers.core.geometry import Array

MAX_REPEAT_ERROR_PX = 2.0
MAX_CORRECT_ERROR_PX = 3.0
MAX_SCALE_RATIO = 1.5
MATCH_RATIO = 0.8


@dataclass(frozen=True)
class FeatureScore:
    """What became of one image's features under one change. Distances are pixels of the original.

    possible   features that lie in both images: the smaller of the two images' counts
    repeated   features found again within 2 px at a scale within a factor of 1.5
    matches    descriptors that found a partner by the ratio test
    errors_px  (correct,) distances of those matches that are within 3 px of where they belong
    """

    max_repeatable: int
    repeated: int
    matches: int
    errors_px: Array

    @property
    def correct(self) -> int:
        """Matches that are right."""
        return len(self.errors_px)


def score_features(
    original: FeatureSet, changed: FeatureSet, H: Array, size: tuple[int, int]
) -> FeatureScore:
    """Compare the features of an image, (width, height), with those of its changed version.

    H  3x3 homography from pixels of the original to pixels of the changed image
    """
    seen_again = is_inside(transform_points(H, original.position_px), size)
    back_px = transform_points(np.asarray(np.linalg.inv(H), np.float64), changed.position_px)
    is_of_original = is_inside(back_px, size)
    back_scale = changed.scale_px / scale_at(H, back_px)
    repeated = count_repeated(
        original.position_px[seen_again],
        original.scale_px[seen_again],
        back_px[is_of_original],
        back_scale[is_of_original],
    )
    pairs = match(original, changed, MATCH_RATIO)
    away_px = original.position_px[pairs[:, 0]] - back_px[pairs[:, 1]]
    errors_px = np.asarray(np.linalg.norm(away_px, axis=1), np.float64)
    return FeatureScore(
        max_repeatable=int(min(seen_again.sum(), is_of_original.sum())),
        repeated=repeated,
        matches=len(pairs),
        errors_px=errors_px[errors_px <= MAX_CORRECT_ERROR_PX],
    )


def transform_points(H: Array, points_px: Array) -> Array:
    """Map (N, 2) pixels by a homography."""
    if len(points_px) == 0:
        return points_px
    return np.asarray(cv2.perspectiveTransform(points_px[None], H)[0], np.float64)


def scale_at(H: Array, points_px: Array) -> Array:
    """(N,) how much larger a homography makes things at (N, 2) pixels: sqrt |det J|."""
    w = points_px @ H[2, :2] + H[2, 2]
    return np.asarray(np.sqrt(np.abs(np.linalg.det(H) / w**3)))


def is_inside(points_px: Array, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Which of (N, 2) pixels lie in an image of (width, height)."""
    return np.asarray(np.all((points_px >= 0) & (points_px <= np.array(size) - 1.0), axis=1))


def count_repeated(a_px: Array, a_scale: Array, b_px: Array, b_scale: Array) -> int:
    """How many features have a counterpart within reach and of like scale, on the poorer side.

    Not one to one: of two features on the same spot both count, but never more than either holds.
    """
    if len(a_px) == 0 or len(b_px) == 0:
        return 0
    distance_px = np.linalg.norm(a_px[:, None] - b_px[None], axis=2)
    scale_step = np.abs(np.log(a_scale[:, None] / b_scale[None]))
    is_same = (distance_px <= MAX_REPEAT_ERROR_PX) & (scale_step < np.log(MAX_SCALE_RATIO))
    return int(min(is_same.any(axis=1).sum(), is_same.any(axis=0).sum()))

"""Verification of a motion: whether its matches agree or do so by chance.

Brown and Lowe, "Automatic Panoramic Image Stitching using Invariant Features", IJCV 74 (2007),
Section 3.2.
"""

from dataclasses import dataclass
from math import log

# Smallest likelihood ratio of a right motion to chance: one in a million tries is right, and one in
# a thousand accepted motions may be wrong.
MIN_LIKELIHOOD_RATIO = 1e6 * 1e3


@dataclass(frozen=True)
class MatchVerifier:
    """Test whether enough matches agree with a motion.

    Attributes:
        inlier_share_if_right: Share of matches that agree with a right motion.
        inlier_share_by_chance: Share of matches that agree with a wrong motion.
    """

    inlier_share_if_right: float
    inlier_share_by_chance: float

    def accepts(self, inliers: int, matches: int) -> bool:
        """Whether `inliers` of `matches` are too many for chance."""
        log_ratio_per_inlier = log(self.inlier_share_if_right / self.inlier_share_by_chance)
        log_ratio_per_outlier = log(
            (1.0 - self.inlier_share_if_right) / (1.0 - self.inlier_share_by_chance)
        )
        return inliers * log_ratio_per_inlier + (matches - inliers) * log_ratio_per_outlier > log(
            MIN_LIKELIHOOD_RATIO
        )

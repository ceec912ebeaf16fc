"""Is a motion right, or do its matches agree by chance? The more is tried, the likelier chance is.

Brown and Lowe, "Automatic Panoramic Image Stitching using Invariant Features", IJCV 74 (2007),
Section 3.2.
"""

from dataclasses import dataclass
from math import log

# How much likelier than chance what is seen must be: a motion is right once in a million tries, and
# may be accepted wrongly once in a thousand times.
MIN_LIKELIHOOD_RATIO = 1e6 * 1e3


@dataclass(frozen=True)
class MatchVerifier:
    """Whether enough of all matches agree with a motion.

    if_right   share of the matches that agree with it if it is right
    by_chance  share of the matches that agree with it if it is wrong
    """

    inlier_share_if_right: float
    inlier_share_by_chance: float

    def accepts(self, inliers: int, matches: int) -> bool:
        """True if `inliers` of `matches` are so many that it cannot well be chance."""
        by_each_inlier = log(self.inlier_share_if_right / self.inlier_share_by_chance)
        by_each_outlier = log(
            (1.0 - self.inlier_share_if_right) / (1.0 - self.inlier_share_by_chance)
        )
        return inliers * by_each_inlier + (matches - inliers) * by_each_outlier > log(
            MIN_LIKELIHOOD_RATIO
        )

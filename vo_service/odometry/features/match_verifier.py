"""Test whether the matches that agree with a motion do so by chance.

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


# The last view is matched near the predicted positions: the weaker ratio test gives more wrong
# matches, but in a circle of 24 pixels or more, few of them are within the 2 pixels of an inlier.
# Or it is matched in the whole image: in 2,500 pairs of views of different rooms at most 3 matches
# agreed, and with a right motion down to a ninth (an Xtion with 0.67 s between frames).
LAST_VIEW_VERIFIER = MatchVerifier(inlier_share_if_right=0.15, inlier_share_by_chance=0.01)
# A motion that is only the initial guess of an alignment, which verifies it. A rolling shutter
# distorts the view, so that few of the matches agree with any one motion.
GUESS_VERIFIER = MatchVerifier(inlier_share_if_right=0.2, inlier_share_by_chance=0.03)

"""Steps with gross errors while the odometry reports that it is tracking.

This is the worst failure: a reported loss can be handled, a wrong pose cannot be noticed.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.tools.evaluation.association import MatchedPoses
from vo_service.tools.evaluation.metrics import PosePairs, relative_errors

# A step has a gross error if it exceeds one of these limits.
GROSS_ERROR_M = 0.05
GROSS_ERROR_DEG = 3.0


def tracked_steps(matched: MatchedPoses, stamps_s: Array, epochs: NDArray[np.int64]) -> PosePairs:
    """Pair each matched pose with the next pose of its trajectory, where both have truth.

    Frames without a pose in between do not matter: the next pose continues from the last one.
    Steps into another epoch are left out: there the odometry reports a discontinuity.

    Args:
        matched: Matched poses of a trajectory.
        stamps_s: (N,) stamps of all poses of this trajectory.
        epochs: (N,) their epochs.
    """
    order = np.searchsorted(stamps_s, matched.stamps_s)
    is_next = (np.diff(order) == 1) & (np.diff(epochs[order]) == 0)
    earlier = np.flatnonzero(is_next)
    return PosePairs(earlier, earlier + 1)


def count_gross_errors(matched: MatchedPoses, steps: PosePairs) -> int:
    """Count the steps with an error of more than 5 cm or 3 degrees."""
    errors = relative_errors(matched, steps)
    is_gross = (errors.translation_m > GROSS_ERROR_M) | (errors.rotation_deg > GROSS_ERROR_DEG)
    return int(np.count_nonzero(is_gross))

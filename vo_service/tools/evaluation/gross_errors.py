"""Steps that are grossly wrong while the odometry calls itself tracking: the worst defect of all.

What is lost and says so can be dealt with; a robot that believes a wrong pose drives into the wall.
"""

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array
from vo_service.tools.evaluation.association import MatchedPoses
from vo_service.tools.evaluation.metrics import PosePairs, relative_errors

# A step is grossly wrong if it is off by more than one of these.
GROSS_ERROR_M = 0.05
GROSS_ERROR_DEG = 3.0


def tracked_steps(matched: MatchedPoses, stamps_s: Array, epochs: NDArray[np.int64]) -> PosePairs:
    """Each matched pose with the next pose of its trajectory, where both have truth.

    stamps_s, epochs  (N,) of all poses of the trajectory that `matched` is made from

    Frames without a pose in between do not matter: the odometry says that the next pose goes on
    from the last. A step into another epoch is left out: it says itself that this one does not.
    """
    order = np.searchsorted(stamps_s, matched.stamps_s)
    is_next = (np.diff(order) == 1) & (np.diff(epochs[order]) == 0)
    earlier = np.flatnonzero(is_next)
    return PosePairs(earlier, earlier + 1)


def count_gross_errors(matched: MatchedPoses, steps: PosePairs) -> int:
    """How many steps are off by more than 5 cm or 3 degrees."""
    errors = relative_errors(matched, steps)
    is_gross = (errors.translation_m > GROSS_ERROR_M) | (errors.rotation_deg > GROSS_ERROR_DEG)
    return int(np.count_nonzero(is_gross))

"""Whether errors are as large as the covariance that was told with them: no larger, no smaller.

The normalised estimation error squared of Bar-Shalom, Li and Kirubarajan, "Estimation with
Applications to Tracking and Navigation" (2001), Section 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, so3_log

DEGREES_OF_FREEDOM = 6
# 95 % of chi squared of six degrees of freedom lie below this.
CHI2_95_PERCENT = 12.592


@dataclass(frozen=True)
class NeesStatistics:
    """Of many motions and their covariances.

    count    how many
    mean     normalised square of the error, mean over all, for each freedom: 1 is exact, more is
             too sure, less is too careful
    within   share whose 95 % ellipsoid holds the truth
    """

    count: int
    mean_per_dof: float
    fraction_within_95: float


def motion_error(T_true: Array, T_estimated: Array) -> Array:
    """(6,) how far a 4x4 motion is off, in the axes of its end: translation m, rotation rad."""
    off = inverse(T_true) @ T_estimated
    return np.concatenate([off[:3, 3], so3_log(off[:3, :3])])


def nees(error: Array, covariance: Array) -> float:
    """Of an error (6,) and its covariance (6, 6): x^T C^-1 x."""
    return float(error @ np.linalg.solve(covariance, error))


def summarize_nees(nees_values: Sequence[float]) -> NeesStatistics | None:
    """The figures of many; None of none."""
    if not nees_values:
        return None
    squares = np.array(nees_values)
    return NeesStatistics(
        count=len(squares),
        mean_per_dof=float(squares.mean()) / DEGREES_OF_FREEDOM,
        fraction_within_95=float(np.mean(squares <= CHI2_95_PERCENT)),
    )

"""Consistency of motion errors with their estimated covariances.

The normalized estimation error squared (NEES) of Bar-Shalom, Li and Kirubarajan, "Estimation with
Applications to Tracking and Navigation" (2001), Section 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, inverse, so3_log

DEGREES_OF_FREEDOM = 6
# 95 % quantile of chi squared with six degrees of freedom.
CHI2_95_PERCENT = 12.592


@dataclass(frozen=True)
class NeesStatistics:
    """NEES of many motions.

    Attributes:
        count: Number of motions.
        mean_per_dof: Mean NEES per degree of freedom. 1 is consistent, more is overconfident,
            less is too conservative.
        fraction_within_95: Fraction of motions whose 95 % ellipsoid holds the truth.
    """

    count: int
    mean_per_dof: float
    fraction_within_95: float


def motion_error(T_true: Array, T_estimated: Array) -> Array:
    """Return the error (6,) of a 4x4 motion in its end frame: translation m, rotation rad."""
    T_error = inverse(T_true) @ T_estimated
    return np.concatenate([T_error[:3, 3], so3_log(T_error[:3, :3])])


def nees(error: Array, covariance: Array) -> float:
    """Return the NEES x^T C^-1 x of an error x (6,) with covariance C (6, 6)."""
    return float(error @ np.linalg.solve(covariance, error))


def summarize_nees(nees_values: Sequence[float]) -> NeesStatistics | None:
    """Return the statistics of many NEES values, or None without a value."""
    if not nees_values:
        return None
    values = np.array(nees_values)
    return NeesStatistics(
        count=len(values),
        mean_per_dof=float(values.mean()) / DEGREES_OF_FREEDOM,
        fraction_within_95=float(np.mean(values <= CHI2_95_PERCENT)),
    )

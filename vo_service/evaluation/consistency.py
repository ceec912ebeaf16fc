"""Whether errors are as large as the covariance that was told with them: no larger, no smaller.

The normalised estimation error squared of Bar-Shalom, Li and Kirubarajan, "Estimation with
Applications to Tracking and Navigation" (2001), Section 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, inverse, rotation_vector

FREEDOMS = 6
# 95 % of chi squared of six degrees of freedom lie below this.
WITHIN_95 = 12.592


@dataclass(frozen=True)
class Consistency:
    """Of many motions and their covariances.

    count    how many
    mean     normalised square of the error, mean over all, for each freedom: 1 is exact, more is
             too sure, less is too careful
    within   share whose 95 % ellipsoid holds the truth
    """

    count: int
    mean: float
    within: float


def motion_error(T_true: Array, T_told: Array) -> Array:
    """(6,) how far a 4x4 motion is off, in the axes of its end: translation m, rotation rad."""
    off = inverse(T_true) @ T_told
    return np.concatenate([off[:3, 3], rotation_vector(off[:3, :3])])


def normalised_square(error: Array, covariance: Array) -> float:
    """Of an error (6,) and its covariance (6, 6): x^T C^-1 x."""
    return float(error @ np.linalg.solve(covariance, error))


def consistency(normalised_squares: Sequence[float]) -> Consistency | None:
    """The figures of many; None of none."""
    if not normalised_squares:
        return None
    squares = np.array(normalised_squares)
    return Consistency(
        count=len(squares),
        mean=float(squares.mean()) / FREEDOMS,
        within=float(np.mean(squares <= WITHIN_95)),
    )

"""Minimization of the cost over readout and depth offset, with uncertainty."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array

# Start of the search: typical values of a Kinect.
INITIAL_TIMING_S = np.array([0.020, 0.0])
# Steps of the three-by-three grids of costs, at first and for the result.
COARSE_STEP_S, FINE_STEP_S = 0.010, 0.005
# Range of the search; a negative readout means from bottom to top.
MIN_TIMING_S, MAX_TIMING_S = np.array([-0.015, -0.060]), np.array([0.060, 0.060])
MAX_GRIDS = 12
NOTHING_SAVED_PREFIX = "nothing is saved: "
_GRID = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
_CENTER_INDEX = 4

# Arguments: assumed readout and depth offset (2,), s, and candidates (N, 2). Returns costs
# (segments, N), with NaN in the row of an uninformative segment.
CostFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class TimingMinimum:
    """Readout and depth offset (2,) and their standard deviations (2,), s.

    Attributes:
        timing_s: Readout and depth offset.
        sigma_s: Their standard deviations.
        segment_count: Number of informative segments.
    """

    timing_s: Array
    sigma_s: Array
    segment_count: int


def find_minimum(coarse: CostFunction, fine: CostFunction) -> TimingMinimum:
    """Descend on grids of the coarse cost, then of the fine cost, with interpolation.

    Raises:
        UserFacingError: The costs have no minimum.
    """
    stages = [(coarse, COARSE_STEP_S), (fine, FINE_STEP_S)]
    center_s = INITIAL_TIMING_S
    for _ in range(MAX_GRIDS):
        costs, step_s = stages[0]
        table = _select_informative_rows(costs(center_s, center_s + step_s * _GRID))
        total = table.mean(axis=0)
        lowest = int(np.argmin(total))
        if lowest != _CENTER_INDEX:
            center_s = np.clip(center_s + step_s * _GRID[lowest], MIN_TIMING_S, MAX_TIMING_S)
            continue
        offset = np.clip(np.nan_to_num(fit_paraboloid_minimum(total)), -1.0, 1.0)
        center_s = center_s + step_s * offset
        stages.pop(0)
        if not stages:
            return TimingMinimum(center_s, step_s * _jackknife_sigma(table), len(table))
    raise UserFacingError(
        f"{NOTHING_SAVED_PREFIX}no timing explains the images better than others; move the camera "
        "fast, to and fro, in front of objects with texture"
    )


def fit_paraboloid_minimum(values: Array) -> Array:
    """Return the minimum (2,) of the paraboloid through nine values, in steps; NaN if none."""
    x, y = _GRID.T
    powers = np.column_stack([np.ones(9), x, y, x * x, x * y, y * y])
    _, a, b, xx, xy, yy = np.linalg.lstsq(powers, values, rcond=None)[0]
    H = np.array([[2 * xx, xy], [xy, 2 * yy]])
    if np.linalg.eigvalsh(H)[0] <= 0:
        return np.full(2, np.nan)
    offset: Array = np.linalg.solve(H, [-a, -b])
    return offset


def _select_informative_rows(table: Array) -> Array:
    informative: Array = table[np.isfinite(table).all(axis=1)]
    if len(informative) == 0:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera could not be tracked during the fast motion; stay "
            "0.5 to 4 m from objects with texture, in good light, and move less wildly"
        )
    return informative


def _jackknife_sigma(table: Array) -> Array:
    """Return the standard deviation (2,) in steps, by leaving out each segment; inf if unknown."""
    n = len(table)
    if n < 2:
        return np.full(2, np.inf)
    minima = np.array(
        [fit_paraboloid_minimum(np.delete(table, k, axis=0).mean(axis=0)) for k in range(n)]
    )
    if not np.isfinite(minima).all():
        return np.full(2, np.inf)
    sigma: Array = np.sqrt((n - 1) * np.mean((minima - minima.mean(axis=0)) ** 2, axis=0))
    return sigma

"""The least of costs over readout and depth offset, and how sure it is."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array

# Where the search begins: a Kinect as it usually is.
INITIAL_TIMING_S = np.array([0.020, 0.0])
# Costs are asked for on a grid of three by three: far apart at first, then for the result.
COARSE_STEP_S, FINE_STEP_S = 0.010, 0.005
# Timings beyond these are not looked for; a readout below zero goes from bottom to top.
MIN_TIMING_S, MAX_TIMING_S = np.array([-0.015, -0.060]), np.array([0.060, 0.060])
MAX_GRIDS = 12
NOTHING_SAVED_PREFIX = "nothing is saved: "
_GRID = np.array([[i, j] for i in (-1.0, 0.0, 1.0) for j in (-1.0, 0.0, 1.0)])
_CENTER_INDEX = 4

# (2,) readout and depth offset that are thought to be true, in seconds, and (N, 2) to be tried:
# (pieces, N) costs, NaN in the row of a piece of film that tells nothing.
CostFunction = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class TimingMinimum:
    """Readout and depth offset (2,) and their standard deviations (2,), in seconds.

    pieces  pieces of film that told it
    """

    timing_s: Array
    sigma_s: Array
    segment_count: int


def find_minimum(coarse: CostFunction, fine: CostFunction) -> TimingMinimum:
    """Follow the coarse costs down from point to point, then the fine ones, to between points.

    Raises UserFacingError where that leads nowhere.
    """
    stages = [(coarse, COARSE_STEP_S), (fine, FINE_STEP_S)]
    centre_s = INITIAL_TIMING_S
    for _ in range(MAX_GRIDS):
        costs, step_s = stages[0]
        table = _select_informative_rows(costs(centre_s, centre_s + step_s * _GRID))
        total = table.mean(axis=0)
        least = int(np.argmin(total))
        if least != _CENTER_INDEX:
            centre_s = np.clip(centre_s + step_s * _GRID[least], MIN_TIMING_S, MAX_TIMING_S)
            continue
        place = np.clip(np.nan_to_num(fit_paraboloid_minimum(total)), -1.0, 1.0)
        centre_s = centre_s + step_s * place
        stages.pop(0)
        if not stages:
            return TimingMinimum(centre_s, step_s * _jackknife_sigma(table), len(table))
    raise UserFacingError(
        f"{NOTHING_SAVED_PREFIX}no timing explains the images better than others; move the camera "
        "briskly, to and fro, before things with a pattern"
    )


def fit_paraboloid_minimum(values: Array) -> Array:
    """(2,) place of the lowest point of the paraboloid through nine values, in steps; NaN: none."""
    x, y = _GRID.T
    powers = np.column_stack([np.ones(9), x, y, x * x, x * y, y * y])
    _, a, b, xx, xy, yy = np.linalg.lstsq(powers, values, rcond=None)[0]
    H = np.array([[2 * xx, xy], [xy, 2 * yy]])
    if np.linalg.eigvalsh(H)[0] <= 0:
        return np.full(2, np.nan)
    place: Array = np.linalg.solve(H, [-a, -b])
    return place


def _select_informative_rows(table: Array) -> Array:
    telling: Array = table[np.isfinite(table).all(axis=1)]
    if len(telling) == 0:
        raise UserFacingError(
            f"{NOTHING_SAVED_PREFIX}the camera could not be followed while it moved briskly; keep half a "
            "metre to four from things with a pattern, in good light, and move less wildly"
        )
    return telling


def _jackknife_sigma(table: Array) -> Array:
    """(2,) standard deviation in steps, by leaving out each piece (jackknife); inf if unknown."""
    n = len(table)
    if n < 2:
        return np.full(2, np.inf)
    others = np.array(
        [fit_paraboloid_minimum(np.delete(table, k, axis=0).mean(axis=0)) for k in range(n)]
    )
    if not np.isfinite(others).all():
        return np.full(2, np.inf)
    spread: Array = np.sqrt((n - 1) * np.mean((others - others.mean(axis=0)) ** 2, axis=0))
    return spread

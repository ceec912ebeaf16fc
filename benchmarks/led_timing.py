"""Delay from stamp to exposure, from the seen and the commanded switching times of an LED."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array

# Search range: how far the stamp may be before or after the middle of the exposure.
DELAY_GRID_S = np.arange(-0.100, 0.1001, 0.0005)
EXPOSURE_GRID_S = np.arange(0.002, 0.0341, 0.002)
# Fraction of the image's pixels that follow the LED best.
LIT_PIXEL_FRACTION = 0.001


@dataclass(frozen=True)
class LedTiming:
    """The middle of the exposure relative to the stamp.

    Attributes:
        delay_s: Middle of the exposure minus stamp, including the LED's own delay.
        exposure_s: Duration of the exposure.
        explained_variance: Fraction of the brightness's variance that the fit explains.
    """

    delay_s: float
    exposure_s: float
    explained_variance: float


def find_lit_pixels(pictures: NDArray[np.uint8], is_on: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Find the pixels (height, width) of pictures (n, height, width) that follow the LED best."""
    shine = pictures[is_on].mean(axis=0) - pictures[~is_on].mean(axis=0)
    follows = shine / (pictures.std(axis=0) + 1.0)
    count = max(1, round(LIT_PIXEL_FRACTION * follows.size))
    return np.asarray(follows >= np.partition(follows.ravel(), -count)[-count])


def fit_timing(stamps_s: Array, brightness: Array, switched_s: Array) -> LedTiming:
    """Fit delay and exposure.

    Args:
        stamps_s: Stamps (n,).
        brightness: Brightness (n,) of the lit pixels.
        switched_s: Times (m,) of the switching commands on the same clock, the first to on.
    """
    best = LedTiming(0.0, 0.0, -np.inf)
    for exposure_s in EXPOSURE_GRID_S:
        for delay_s in DELAY_GRID_S:
            lit = exposed_fraction(stamps_s + delay_s, exposure_s, switched_s)
            explained = _explained_variance(lit, brightness)
            if explained > best.explained_variance:
                best = LedTiming(float(delay_s), float(exposure_s), explained)
    return best


def exposed_fraction(middles_s: Array, exposure_s: float, switched_s: Array) -> Array:
    """Fraction (n,) of each exposure during which the LED is on."""
    begin, end = middles_s - exposure_s / 2, middles_s + exposure_s / 2
    return (_cumulative_on_s(end, switched_s) - _cumulative_on_s(begin, switched_s)) / exposure_s


def _cumulative_on_s(until_s: Array, switched_s: Array) -> Array:
    """Seconds that the LED was on before each time."""
    is_on = np.arange(len(switched_s)) % 2 == 0
    spans_s = np.diff(switched_s, append=np.inf) * 1.0
    since_s = np.clip(until_s[:, None] - switched_s[None, :], 0.0, spans_s[None, :])
    return np.asarray((since_s * is_on).sum(axis=1))


def _explained_variance(lit: Array, brightness: Array) -> float:
    if lit.std() == 0.0 or brightness.std() == 0.0:
        return 0.0
    return float(np.corrcoef(lit, brightness)[0, 1] ** 2)

"""Interpolating cubic splines with a continuous second derivative."""

import numpy as np

from drivers.core.geometry import Array


class CubicSpline:
    """Natural cubic spline through `values` (N, C) at strictly rising `knots` (N,), N >= 2.

    Outside the knots the end values are held.
    """

    def __init__(self, knots: Array, values: Array) -> None:
        self._knots = knots
        self._values = values
        self._second = _second_derivatives(knots, values)

    def __call__(self, times: Array) -> Array:
        """Values (M, C) at `times` (M,)."""
        knots, times = self._knots, np.clip(times, self._knots[0], self._knots[-1])
        i = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        h = (knots[i + 1] - knots[i])[:, None]
        b = (times - knots[i])[:, None] / h
        a = 1.0 - b
        bend = (a**3 - a) * self._second[i] + (b**3 - b) * self._second[i + 1]
        result: Array = a * self._values[i] + b * self._values[i + 1] + bend * h**2 / 6.0
        return result


def _second_derivatives(knots: Array, values: Array) -> Array:
    """Solve the tridiagonal system of a natural spline by Thomas' algorithm, for all columns."""
    n = len(knots)
    h = np.diff(knots)
    slope = np.diff(values, axis=0) / h[:, None]
    rhs = 6.0 * np.diff(slope, axis=0)
    upper = np.zeros(n)
    second = np.zeros_like(values)
    for i in range(1, n - 1):
        pivot = 2.0 * (h[i - 1] + h[i]) - h[i - 1] * upper[i - 1]
        upper[i] = h[i] / pivot
        second[i] = (rhs[i - 1] - h[i - 1] * second[i - 1]) / pivot
    for i in range(n - 2, 0, -1):
        second[i] -= upper[i] * second[i + 1]
    return second

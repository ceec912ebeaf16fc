"""Nonlinear least squares for about ten parameters and thousands of residuals."""

from collections.abc import Callable, Sequence

import numpy as np

from drivers.core.geometry import Array

Residuals = Callable[[Array], Array]
RELATIVE_STEP = 1e-6
DAMPING = 1e-9


def minimize_gauss_newton(
    residuals: Residuals, start: Array, weights: Array, steps: int = 10
) -> Array:
    """Minimize weighted residuals (N,) by Gauss-Newton and return the parameters (P,).

    Each parameter must influence some residual; the conditioning is not checked.

    Args:
        residuals: Function of the parameters (P,) that returns residuals (N,).
        start: (P,) initial parameters.
        weights: (N,) weights of the residuals.
        steps: Maximum number of iterations.
    """
    x = start.copy()
    for _ in range(steps):
        J = jacobian(residuals, x) * weights[:, None]
        change = _solve(J.T @ J, J.T @ (residuals(x) * weights))
        x -= change
        if np.all(np.abs(change) < RELATIVE_STEP * np.maximum(1.0, np.abs(x))):
            break
    return x


def jacobian(residuals: Residuals, x: Array) -> Array:
    """Return the Jacobian (N, P) by central differences."""
    columns = []
    for index, value in enumerate(x):
        step = np.zeros_like(x)
        step[index] = RELATIVE_STEP * max(1.0, abs(value))
        columns.append((residuals(x + step) - residuals(x - step)) / (2 * step[index]))
    return np.column_stack(columns)


def jackknife_sigma(fits: Sequence[Array]) -> Array:
    """Return standard deviations (P,) from fits (P,) that each leave out one of the groups.

    They include all variation between views, of any cause (Efron and Stein, The jackknife estimate
    of variance, Annals of Statistics 9(3), 1981).
    """
    deviations = np.asarray(fits) - np.mean(fits, axis=0)
    count = len(fits)
    sigma: Array = np.sqrt((count - 1) / count * (deviations**2).sum(axis=0))
    return sigma


def _solve(A: Array, b: Array) -> Array:
    """Solve A x = b, scaled to a unit diagonal because pixels and radians differ by a thousand."""
    scale = 1.0 / np.sqrt(np.diag(A))
    scaled = A * np.outer(scale, scale) + DAMPING * np.eye(len(A))
    return scale * np.linalg.solve(scaled, scale * b)

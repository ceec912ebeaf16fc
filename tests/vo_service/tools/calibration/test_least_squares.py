"""The solver on problems with a known solution."""

import numpy as np
import scipy.optimize
from hypothesis import given
from hypothesis import strategies as st

from drivers.core.geometry import Array
from vo_service.tools.calibration.least_squares import (
    jackknife_sigma,
    jacobian,
    minimize_gauss_newton,
)


@given(st.integers(0, 10_000))
def test_a_linear_problem_is_solved_as_by_numpy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    # Parameters of very different size, like pixels and radians.
    A, b = rng.normal(size=(30, 4)) * [1.0, 100.0, 1e-2, 10.0], rng.normal(size=30)
    weights = rng.uniform(0.5, 2.0, 30)
    expected = np.linalg.lstsq(A * weights[:, None], b * weights, rcond=None)[0]
    solution = minimize_gauss_newton(lambda x: A @ x - b, np.zeros(4), weights)
    np.testing.assert_allclose(solution, expected, rtol=1e-4, atol=1e-6)


def test_a_curve_is_fitted_as_by_scipy() -> None:
    rng = np.random.default_rng(0)
    t = np.linspace(0, 4, 80)
    y = 2.0 * np.exp(-0.7 * t) + rng.normal(0, 0.02, 80)

    def residuals(x: Array) -> Array:
        curve: Array = x[0] * np.exp(-x[1] * t) - y
        return curve

    expected = scipy.optimize.least_squares(residuals, [1.0, 1.0]).x
    solution = minimize_gauss_newton(residuals, np.array([1.0, 1.0]), np.ones(80))
    np.testing.assert_allclose(solution, expected, rtol=1e-5)


def test_the_jacobian_is_the_analytic_one() -> None:
    x = np.array([0.3, 2.0])
    J = jacobian(lambda p: np.array([np.sin(p[0]) * p[1], p[1] ** 3]), x)
    expected = [[np.cos(0.3) * 2.0, np.sin(0.3)], [0.0, 12.0]]
    np.testing.assert_allclose(J, expected, atol=1e-8)


def test_the_jackknife_gives_the_standard_error_of_a_mean() -> None:
    values = np.random.default_rng(0).normal(5.0, 2.0, 40)
    fits = [np.array([np.delete(values, n).mean()]) for n in range(40)]
    expected = values.std(ddof=1) / np.sqrt(40)
    np.testing.assert_allclose(jackknife_sigma(fits), [expected])

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from vo_service.odometry.direct.small_matrices import (
    invert_cholesky,
    multiply,
    multiply_vector,
    solve_cholesky,
    transform_covariance,
)

FEW = settings(max_examples=30)


@FEW
@given(st.integers(0, 2**32 - 1), st.sampled_from([6, 15]))
def test_a_positive_definite_system_is_solved(seed: int, size: int) -> None:
    random = np.random.default_rng(seed)
    A = random.normal(size=(size, 2 * size))
    A, b = A @ A.T, random.normal(size=size)
    np.testing.assert_allclose(solve_cholesky(A, b), np.linalg.solve(A, b), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(invert_cholesky(A) @ A, np.eye(size), atol=1e-6)


def test_an_empty_system_has_a_solution() -> None:
    assert np.all(np.isfinite(solve_cholesky(np.zeros((6, 6)), np.zeros(6))))


@FEW
@given(st.integers(0, 2**32 - 1))
def test_products_are_those_of_matrices(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, B, x = random.normal(size=(6, 9)), random.normal(size=(9, 4)), random.normal(size=9)
    covariance = np.diag(random.uniform(size=9))
    np.testing.assert_allclose(multiply(A, B), A @ B, atol=1e-12)
    np.testing.assert_allclose(multiply_vector(A, x), A @ x, atol=1e-12)
    np.testing.assert_allclose(transform_covariance(A, covariance), A @ covariance @ A.T)

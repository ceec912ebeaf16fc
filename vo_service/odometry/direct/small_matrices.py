"""Linear algebra of small matrices in kernels, as each call from Python takes time.

Loops instead of array expressions, which take the compiler ten times as long.
"""

import numpy as np

from drivers.core.geometry import Array
from drivers.core.jit import inline_kernel, kernel

# Smallest pivot of a factorization, so that rounding makes no root of a negative number.
MIN_PIVOT = 1e-12
# Added to the diagonal of an information matrix, relative to its trace, before it is inverted.
REGULARIZATION = 1e-9
# Keeps the marginalization finite where a view does not constrain the pose, relative to its scale.
MARGINAL_DAMPING_RATIO = 1e-6


@kernel
def multiply(A: Array, B: Array) -> Array:
    """(N, K) product of A (N, M) and B (M, K)."""
    product = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                product[i, j] += A[i, k] * B[k, j]
    return product


@kernel
def multiply_vector(A: Array, x: Array) -> Array:
    """(N,) product of A (N, M) and x (M,)."""
    product = np.zeros(len(A))
    for i in range(len(A)):
        for k in range(len(x)):
            product[i] += A[i, k] * x[k]
    return product


@kernel
def transform_covariance(A: Array, covariance: Array) -> Array:
    """(N, N) A C A^T of A (N, M) and a symmetric C (M, M)."""
    n, half = len(A), multiply(A, covariance)
    transformed = np.zeros((n, n))
    for i in range(n):
        for j in range(i, n):
            for k in range(A.shape[1]):
                transformed[i, j] += half[i, k] * A[j, k]
            transformed[j, i] = transformed[i, j]
    return transformed


@inline_kernel
def add_outer_product(total: Array, vector: Array) -> None:
    """Add x x^T of a vector (N,) to a matrix (N, N)."""
    for a in range(len(vector)):
        for b in range(len(vector)):
            total[a, b] += vector[a] * vector[b]


@kernel
def solve_cholesky(A: Array, b: Array) -> Array:
    """Solve A x = b by Cholesky factorization; A is symmetric and positive definite.

    Only the lower triangle of A is used.
    """
    x = b.copy()
    _substitute(_factorize(A), x)
    return x


@kernel
def invert_cholesky(A: Array) -> Array:
    """Inverse of A (N, N), see `solve_cholesky`."""
    n, L = len(A), _factorize(A)
    inverse, column = np.empty((n, n)), np.empty(n)
    for k in range(n):
        for i in range(n):
            column[i] = 1.0 if i == k else 0.0
        _substitute(L, column)
        for i in range(n):
            inverse[k, i] = column[i]
    return inverse


@kernel
def invert_information(H: Array) -> Array:
    """Inverse of an information matrix (N, N), which is regularized."""
    regularized, trace = H.copy(), 0.0
    for k in range(len(H)):
        trace += H[k, k]
    for k in range(len(H)):
        regularized[k, k] += REGULARIZATION * trace
    return invert_cholesky(regularized)


@kernel
def _factorize(A: Array) -> Array:
    """(N, N) lower triangular L with L L^T = A."""
    n = len(A)
    L = np.zeros((n, n))
    for j in range(n):
        for i in range(j, n):
            total = A[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            L[i, j] = np.sqrt(max(total, MIN_PIVOT)) if i == j else total / L[j, j]
    return L


@kernel
def _substitute(L: Array, x: Array) -> None:
    """Replace x (N,) by the solution of L L^T y = x, by forward and backward substitution."""
    n = len(x)
    for i in range(n):
        for k in range(i):
            x[i] -= L[i, k] * x[k]
        x[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= L[k, i] * x[k]
        x[i] /= L[i, i]


@inline_kernel
def add_residual(H: Array, g: Array, row: Array, weight: float, weighted_residual: float) -> None:
    """Add a residual to normal equations, of whose matrix only the upper triangle is used.

    Args:
        H: (N, N), in and out.
        g: (N,), in and out.
        row: (N,) derivatives of the residual.
        weight: Of the derivatives.
        weighted_residual: The residual times its weight.
    """
    for a in range(len(row)):
        weighted = weight * row[a]
        for b in range(a, len(row)):
            H[a, b] += weighted * row[b]
        g[a] += row[a] * weighted_residual


@kernel
def marginalize(H: Array, g: Array, kept: int) -> Array:
    """Marginalize all but the last unknowns of normal equations (Schur complement).

    Args:
        H: (N, N), of which the upper triangle is used.
        g: (N,).
        kept: Number K of the unknowns that are kept.

    Returns:
        (K, K + 1) information [A b]: A x = b at the best step x.
    """
    n = len(g) - kept
    scale, X, Y = np.empty(n), np.empty((n, n)), np.empty((n, kept + 1))
    for a in range(n):
        scale[a] = 1.0 / np.sqrt(H[a, a] + MIN_PIVOT)
    for a in range(n):
        for b in range(a, n):
            X[b, a] = H[a, b] * scale[b] * scale[a]
        X[a, a] += MARGINAL_DAMPING_RATIO
        for k in range(kept):
            Y[a, k] = H[a, n + k] * scale[a]
        Y[a, kept] = g[a] * scale[a]
    solved, L, column = np.empty((n, kept + 1)), _factorize(X), np.empty(n)
    for k in range(kept + 1):
        for a in range(n):
            column[a] = Y[a, k]
        _substitute(L, column)
        for a in range(n):
            solved[a, k] = column[a]
    information = np.empty((kept, kept + 1))
    for a in range(kept):
        for b in range(kept):
            information[a, b] = H[n + min(a, b), n + max(a, b)]
            for k in range(n):
                information[a, b] -= Y[k, a] * solved[k, b]
        information[a, kept] = -g[n + a]
        for k in range(n):
            information[a, kept] += Y[k, a] * solved[k, kept]
    return information

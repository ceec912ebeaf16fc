"""How numeric kernels are compiled: one place, so that all of them share the same guarantees."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile to machine code without Python's lock, cached on disk.

    ``fastmath`` stays off: results are then the same bits with SSE2, AVX2 and AVX-512.
    """
    compiled: Callable[P, R] = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return compiled


def inline_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small helper that is inlined into the kernels that call it."""
    compiled: Callable[P, R] = numba.njit(
        nogil=True, cache=True, error_model="numpy", inline="always"
    )(function)
    return compiled

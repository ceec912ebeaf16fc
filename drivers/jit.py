"""How numeric kernels are compiled: one place, so that all of them share the same guarantees."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

import numba
from numba.core import event

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


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` before each kernel that is compiled in the block; what it raises ends the block.

    A signal's exception would be lost in LLVM's calls back into Python, or break the compiling.
    """
    with event.install_listener("numba:compile", _Check(check)):
        yield


class _Check(event.Listener):
    def __init__(self, check: Callable[[], None]) -> None:
        self._check = check

    def on_start(self, event: event.Event) -> None:
        """Called by Numba before it compiles."""
        self._check()

    def on_end(self, event: event.Event) -> None:
        """Called by Numba afterwards."""

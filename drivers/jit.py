"""How numeric kernels are compiled: one place, so that all of them share the same guarantees.

Numba takes half a second to import: whoever has no kernels to compile is spared that.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile to machine code without Python's lock, cached on disk.

    ``fastmath`` stays off: results are then the same bits with SSE2, AVX2 and AVX-512.
    """
    import numba

    compiled: Callable[P, R] = numba.njit(nogil=True, cache=True, error_model="numpy")(function)
    return compiled


def inline_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small helper that is inlined into the kernels that call it."""
    import numba

    compiled: Callable[P, R] = numba.njit(
        nogil=True, cache=True, error_model="numpy", inline="always"
    )(function)
    return compiled


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` before each kernel that is compiled in the block; what it raises ends the block.

    A signal's exception would be lost in LLVM's calls back into Python, or break the compiling.
    """
    from numba.core import event

    class Check(event.Listener):
        def on_start(self, event: object) -> None:
            check()

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", Check()):
        yield

"""How numeric kernels are compiled: one place, so that all of them share the same guarantees.

Numba takes half a second to import: whoever has no kernels to compile is spared that.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile to machine code without Python's lock, cached on disk.

    ``fastmath`` stays off: results are then the same bits with SSE2, AVX2 and AVX-512.
    """
    compiled: Callable[P, R] = _njit()(nogil=True, cache=True, error_model="numpy")(function)
    return compiled


def inline_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a small helper that is inlined into the kernels that call it."""
    compiled: Callable[P, R] = _njit()(
        nogil=True, cache=True, error_model="numpy", inline="always"
    )(function)
    return compiled


@cache
def _njit() -> Any:
    """Numba's decorator, imported without SciPy's linear algebra: 13 MB in each process.

    Numba imports that only to see whether it is there; a kernel that uses it gets it nevertheless.
    """
    import numba

    if "scipy.linalg" not in sys.modules:
        sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails
        try:
            import numba.np.arraymath
        finally:
            del sys.modules["scipy.linalg"]
    return numba.njit


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` before each kernel that is compiled in the block; what it raises ends the block.

    A signal's exception would be lost in LLVM's calls back into Python, or break the compiling.
    """
    from numba.core import event

    class InterruptCheck(event.Listener):
        def on_start(self, event: object) -> None:
            check()

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", InterruptCheck()):
        yield

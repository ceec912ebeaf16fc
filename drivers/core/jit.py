"""Decorators that compile numeric kernels, all with the same guarantees.

Numba takes half a second to import, so it is imported with the first kernel.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any, ParamSpec, TypeVar

from drivers.core.folders import kernel_folder

P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile to machine code that releases the GIL, cached on disk.

    ``fastmath`` stays off, so that results are bit-identical with SSE2, AVX2 and AVX-512.
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
    """Import Numba's decorator without SciPy's linear algebra, which takes 13 MB per process.

    Numba imports it only to check that it exists. A kernel that uses it still gets it.
    """
    import numba

    if "scipy.linalg" not in sys.modules:
        sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails
        try:
            import numba.np.arraymath
        finally:
            del sys.modules["scipy.linalg"]
    config: Any = numba.config
    if not config.CACHE_DIR:  # the command line sets it; a program that imports us does not
        config.CACHE_DIR = str(kernel_folder())
    return numba.njit


@contextmanager
def interruptible(check: Callable[[], None]) -> Iterator[None]:
    """Call `check` before each compilation of a kernel in the block; its exception ends the block.

    A signal handler's exception would be lost in LLVM's callbacks, or break the compilation.
    """
    from numba.core import event

    class InterruptCheck(event.Listener):
        def on_start(self, event: object) -> None:
            check()

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", InterruptCheck()):
        yield

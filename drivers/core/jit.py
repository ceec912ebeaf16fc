"""Decorators that compile numeric kernels, all with the same guarantees.

Numba takes half a second to import, so it is imported with the first kernel.
"""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, ParamSpec, TypeVar

from drivers.core.errors import UserFacingError
from drivers.core.folders import kernel_folder

logger = logging.getLogger(__name__)
P = ParamSpec("P")
R = TypeVar("R")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile to machine code that releases the GIL, cached on disk.

    ``fastmath`` stays off, so that results are bit-identical with SSE2, AVX2 and AVX-512.
    """
    compiled: Callable[P, R] = _njit()(nogil=True, cache=True, error_model="numpy")(function)
    cache = getattr(compiled, "_cache", None)  # there is none with NUMBA_DISABLE_JIT
    if cache is not None:
        _replace_damaged_files(cache)
        _drop_loaded_modules(cache)
    return compiled


def _replace_damaged_files(cache: Any) -> None:
    """Let a kernel whose files in the cache are damaged, as by a power cut, be compiled anew."""

    def load_undamaged(signature: Any, context: Any) -> Any:
        try:
            return _load_overload(cache, signature, context)
        except OSError:
            raise
        except Exception:  # pickle raises any exception for a damaged file
            logger.warning("%s: a damaged kernel is compiled anew", cache.cache_path)
            cache.flush()
            return None

    cache.load_overload = load_undamaged


def _load_overload(cache: Any, signature: Any, context: Any) -> Any:
    """Load a kernel without preparing the compiler, which takes 8 MB and 0.3 s per process.

    A compilation prepares it by itself.
    """
    if not hasattr(cache, "_load_overload"):
        return type(cache).load_overload(cache, signature, context)
    from numba.core.runtime.nrt import rtsys

    rtsys.initialize(context)  # memory of kernels
    return cache._load_overload(signature, context)


def _drop_loaded_modules(cache: Any) -> None:
    """Let a kernel that is loaded from the cache keep bitcode instead of its compiler's module.

    Numba keeps the module for a later compilation of a kernel that calls this one, which hardly
    ever happens. The bitcode serves as well, in a seventh of the memory.
    """
    implementation = getattr(cache, "_impl", None)
    if implementation is None:
        return
    rebuild = implementation.rebuild

    def rebuild_small(context: Any, payload: Any) -> Any:
        result = rebuild(context, payload)
        _name, kind, data = payload[0]
        if kind == "object" and hasattr(result.library, "_shared_module"):
            result.library._shared_module = None
            result.library._get_module_for_linking = partial(_parse_bitcode, data[1])
        return result

    implementation.rebuild = rebuild_small


def _parse_bitcode(bitcode: bytes) -> Any:
    from llvmlite.binding import parse_bitcode

    return parse_bitcode(bitcode)


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
    _check_cache_folder(Path(config.CACHE_DIR))
    return numba.njit


def _check_cache_folder(folder: Path) -> None:
    """Raise UserFacingError if kernels cannot be written there."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise UserFacingError(
            f"{folder}: the compiled kernels cannot be written: {error.strerror}; set "
            "NUMBA_CACHE_DIR to another folder"
        ) from error


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

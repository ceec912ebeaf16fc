"""Fewer malloc arenas and the release of unused memory, for robots with little memory."""

import ctypes
import os
from pathlib import Path

_ARENA_MAX = -8  # mallopt(3)
_MADV_DONTNEED = 4  # madvise(2)
# The compiler is needed only while kernels are compiled or loaded.
_COMPILER_LIBRARY = "libllvmlite"


def limit_malloc_arenas(max_arenas: int = 1) -> None:
    """Limit the malloc arenas of this process and of the processes that it starts.

    Freed memory stays in the arenas of its threads, and the default limit is eight per core. One
    is enough: Python's lock keeps the threads from allocating at the same time.
    """
    os.environ.setdefault("MALLOC_ARENA_MAX", str(max_arenas))
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):  # another C library has no arenas
        libc.mallopt(_ARENA_MAX, int(os.environ["MALLOC_ARENA_MAX"]))


def release_memory() -> None:
    """Return freed memory and the compiler's code to the system, after kernels are prepared.

    The code is mapped from a file, so the kernel loads it again when it is needed.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    for line in Path("/proc/self/maps").read_text().splitlines():
        addresses, access, *_ = line.split()
        # Only the code: the library's data are relocated and could not be loaded again.
        if _COMPILER_LIBRARY in line and access.startswith("r-x"):
            begin, end = (int(address, 16) for address in addresses.split("-"))
            libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)

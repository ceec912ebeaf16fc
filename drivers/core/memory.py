"""Memory that a process has no use for any more, given back: a robot's board has little."""

import ctypes
import os
from pathlib import Path

_ARENA_MAX = -8  # mallopt(3)
_MADV_DONTNEED = 4  # madvise(2)
# Needed only while kernels are compiled or loaded.
_COMPILER_LIBRARY = "libllvmlite"


def limit_malloc_arenas(max_arenas: int = 2) -> None:
    """Let the threads of this process, and of those that it starts, share a few malloc arenas.

    Memory that threads free stays in their arenas, of which there may be eight for each core.
    """
    os.environ.setdefault("MALLOC_ARENA_MAX", str(max_arenas))
    libc = ctypes.CDLL(None)
    if hasattr(libc, "mallopt"):  # another C library has no arenas
        libc.mallopt(_ARENA_MAX, int(os.environ["MALLOC_ARENA_MAX"]))


def release_memory() -> None:
    """Give back what was needed to prepare kernels: freed memory and the compiler's code.

    The code is mapped from a file, so it comes back by itself where it is needed again.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    for line in Path("/proc/self/maps").read_text().splitlines():
        addresses, access, *_ = line.split()
        if _COMPILER_LIBRARY in line and access.startswith(
            "r-x"
        ):  # not its data, which is relocated
            begin, end = (int(address, 16) for address in addresses.split("-"))
            libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)

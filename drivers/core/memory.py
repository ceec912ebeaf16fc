"""Release of memory to the system, and limits of what a process keeps."""

import ctypes
import os
import re
from collections.abc import Iterator
from pathlib import Path

# mallopt(3): environment variable, parameter, value.
_MALLOC_LIMITS = (
    # Freed memory stays in the arenas of its threads, and the default limit is eight per core. One
    # is enough: Python's lock keeps the threads from allocating at the same time.
    ("MALLOC_ARENA_MAX", -8, 1),
    # Larger arrays have pages of their own, which return to the system when they are freed. By
    # default this limit grows to 32 MB, and freed maps stay in the heap. Images are smaller: new
    # pages for the depth of each frame would take twice as long as its computation.
    ("MALLOC_MMAP_THRESHOLD_", -3, 2_000_000),
    ("MALLOC_TRIM_THRESHOLD_", -1, 4_000_000),
)
_MADV_DONTNEED = 4  # madvise(2)
# The compiler is needed only while kernels are compiled or loaded.
_COMPILER_LIBRARY = "libllvmlite"


def limit_freed_memory() -> None:
    """Limit the freed memory that this process and the processes that it starts keep.

    A variable of the environment that the user has set has precedence.
    """
    libc = ctypes.CDLL(None)
    for variable, parameter, value in _MALLOC_LIMITS:
        if variable not in os.environ:
            os.environ[variable] = str(value)
            if hasattr(libc, "mallopt"):  # another C library has no such limits
                libc.mallopt(parameter, value)


def release_memory() -> None:
    """Return freed memory and the compiler's pages to the system, after kernels are prepared.

    Its code and constants are mapped from a file, and are loaded again when they are needed.
    """
    libc = ctypes.CDLL(None)
    if hasattr(libc, "malloc_trim"):
        libc.malloc_trim(0)
    for begin, end in _find_unchanged_mappings(Path("/proc/self/smaps").read_text()):
        libc.madvise(ctypes.c_void_p(begin), ctypes.c_size_t(end - begin), _MADV_DONTNEED)


def _find_unchanged_mappings(smaps: str) -> Iterator[tuple[int, int]]:
    """Addresses of the compiler's code and constants that equal their file."""
    for mapping in re.split(r"^(?=[0-9a-f]+-[0-9a-f]+ )", smaps, flags=re.MULTILINE):
        head = mapping.partition("\n")[0]
        if _COMPILER_LIBRARY not in head:
            continue
        addresses, access, *_ = head.split()
        # Relocated constants are no longer those of the file.
        if "w" not in access and re.search(r"^Anonymous: +0 kB$", mapping, re.MULTILINE):
            begin, end = addresses.split("-")
            yield int(begin, 16), int(end, 16)


def available_memory_bytes() -> int:
    """Return how much memory new processes can have without swapping (Linux, proc(5))."""
    match = re.search(r"^MemAvailable: +(\d+) kB$", Path("/proc/meminfo").read_text(), re.MULTILINE)
    return int(match[1]) << 10 if match else 0

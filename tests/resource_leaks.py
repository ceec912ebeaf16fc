"""What a process holds, to see that it holds no more afterwards."""

import gc
import os
import re
import threading
from collections import Counter
from pathlib import Path

from tests.forked_process import templates


def resources_in_use() -> Counter[str]:
    """Open files, children (zombies too), threads and shared memory of this process.

    Compare with ``<=``: what an earlier test had left for the garbage may go at any time.
    """
    gc.collect()
    return Counter(
        files=count_open_files(),
        children=len(child_pids()),
        threads=threading.active_count(),
        memory=Path("/proc/self/maps").read_text().count("memfd:"),
    )


def count_open_files() -> int:
    """How many files this process has open."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def count_open_files_of(process: int) -> int:
    """How many files a process that may not be this one has open."""
    return sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())


def child_pids() -> list[int]:
    """Process numbers of what this process has started and not reaped.

    Not the one that `ForkedProcess` processes are forked from, which stays to the end.
    """
    return [child for child in child_pids_of(os.getpid()) if child not in templates()]


def resources_in_use_by(process: int) -> Counter[str]:
    """Open files, children, threads and shared memory of a process that may not be this one.

    Not the threads that a library has named: Zenoh starts and ends its own as it sees fit.
    """
    here = Path(f"/proc/{process}")
    own_name = _read_text(here / "comm")
    return Counter(
        files=count_open_files_of(process),
        children=len(child_pids_of(process)),
        threads=sum(_read_text(task / "comm") == own_name for task in (here / "task").iterdir()),
        memory=_read_text(here / "maps").count("memfd:"),
    )


def child_pids_of(process: int) -> list[int]:
    """Process numbers of what a process has started and not reaped."""
    lists = Path(f"/proc/{process}/task").glob("*/children")
    return [int(number) for each in lists for number in _read_text(each).split()]


def find_child_running(process: int, module: str) -> int:
    """The child of a process that runs a Python module; fails unless there is exactly one."""
    (found,) = (c for c in child_pids_of(process) if module in command_line_of(c))
    return found


def command_line_of(process: int) -> list[str]:
    """The command line of a process; [] once it has ended."""
    return _read_text(Path(f"/proc/{process}/cmdline")).split("\0")[:-1]


def resident_memory_kb(process: int) -> int:
    """Memory of a process that is in RAM."""
    status = Path(f"/proc/{process}/status").read_text()
    found = re.search(r"VmRSS:\s+(\d+) kB", status)
    assert found is not None
    return int(found[1])


def is_alive(process: int) -> bool:
    """Whether a process, which may not be ours, still runs."""
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def _read_text(file: Path) -> str:
    """A file of /proc; "" if what it tells of has just ended."""
    try:
        return file.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""

"""What a process holds, to see that it holds no more afterwards."""

import gc
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

PATIENCE_S = 30.0


def belongings() -> Counter[str]:
    """Open files, children (zombies too), threads and shared memory of this process.

    Compare with ``<=``: what an earlier test had left for the garbage may go at any time.
    """
    gc.collect()
    return Counter(
        files=open_files(),
        children=len(children()),
        threads=threading.active_count(),
        memory=Path("/proc/self/maps").read_text().count("memfd:"),
    )


def open_files() -> int:
    """How many files this process has open."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def children() -> list[int]:
    """Process numbers of what this process has started and not reaped."""
    lists = Path("/proc/self/task").glob("*/children")
    return [int(number) for each in lists for number in each.read_text().split()]


def is_alive(process: int) -> bool:
    """Whether a process, which may not be ours, still runs."""
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def wait_for(holds: Callable[[], bool], what: str = "") -> None:
    """Until something holds; a test that waits in vain fails."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < deadline_s, f"waited in vain {what}"
        time.sleep(0.01)

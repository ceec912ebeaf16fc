"""Resources of a process, for leak tests."""

import gc
import os
import re
import threading
from collections import Counter
from contextlib import suppress
from pathlib import Path

from tests.forked_process import fork_server_pids


def resources_in_use() -> Counter[str]:
    """Count open files, children (and zombies), threads and shared memory of this process.

    The fork server and its socket are not counted: any test may be the first that needs them.
    Compare with ``<=``: garbage of an earlier test may be freed at any time.
    """
    gc.collect()
    return Counter(
        files=count_open_files() - len(fork_server_pids()),
        children=len(child_pids()),
        threads=threading.active_count(),
        memory=Path("/proc/self/maps").read_text().count("memfd:"),
    )


def count_open_files() -> int:
    """Count the open files of this process."""
    return sum(1 for _ in Path("/proc/self/fd").iterdir())


def count_open_files_of(process: int) -> int:
    """Count the open files of any process."""
    return sum(1 for _ in Path(f"/proc/{process}/fd").iterdir())


def child_pids() -> list[int]:
    """Process numbers of the unreaped children of this process, without the tests' own helpers."""
    return [
        child
        for child in child_pids_of(os.getpid())
        if child not in fork_server_pids() and not _is_resource_tracker(child)
    ]


def _is_resource_tracker(process: int) -> bool:
    """Whether it is multiprocessing's helper, which stays after the first pool of a benchmark."""
    return any("multiprocessing.resource_tracker" in word for word in command_line_of(process))


def resources_in_use_by(process: int) -> Counter[str]:
    """Count open files, children, threads and shared memory of any process.

    Threads with a name are not counted: Zenoh starts and ends its threads at any time.
    """
    folder = Path(f"/proc/{process}")
    own_name = _read_text(folder / "comm")
    return Counter(
        files=count_open_files_of(process),
        children=len(child_pids_of(process)),
        threads=sum(_read_text(task / "comm") == own_name for task in (folder / "task").iterdir()),
        memory=_read_text(folder / "maps").count("memfd:"),
    )


def child_pids_of(process: int) -> list[int]:
    """Process numbers of the unreaped children of any process."""
    lists = Path(f"/proc/{process}/task").glob("*/children")
    return [int(number) for each in lists for number in _read_text(each).split()]


def find_child_running(process: int, module: str) -> int:
    """Return the child of a process that runs a module; fails unless there is exactly one."""
    (child,) = (c for c in child_pids_of(process) if module in command_line_of(c))
    return child


def command_line_of(process: int) -> list[str]:
    """The command line of a process; [] once it has ended."""
    return _read_text(Path(f"/proc/{process}/cmdline")).split("\0")[:-1]


def resident_memory_kb(process: int) -> int:
    """Resident memory of a process in kB."""
    status = Path(f"/proc/{process}/status").read_text()
    match = re.search(r"VmRSS:\s+(\d+) kB", status)
    assert match is not None
    return int(match[1])


def is_alive(process: int) -> bool:
    """Whether a process runs; it need not be a child."""
    try:
        return " Z " not in Path(f"/proc/{process}/stat").read_text()
    except OSError:
        return False


def _read_text(file: Path) -> str:
    """Read a file of /proc; "" if its process has just ended."""
    try:
        return file.read_text()
    except (FileNotFoundError, ProcessLookupError):
        return ""


def open_files(process: int) -> list[str]:
    """What the open files of a process are; it may close some meanwhile."""
    files = []
    for fd in Path(f"/proc/{process}/fd").iterdir():
        with suppress(FileNotFoundError):
            files.append(str(fd.readlink()))
    return files

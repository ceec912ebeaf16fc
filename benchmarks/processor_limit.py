"""Limits the processor time of running processes by a control group, like systemd's CPUQuota."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

PERIOD_US = 100_000  # as systemd
STOP_TIMEOUT_S = 10.0


@contextmanager
def limit_processor(percent: float) -> Iterator[Callable[[Iterable[int]], None]]:
    """Create a control group whose processes together get `percent` of one processor.

    At the end its processes return to the parent group.

    Yields:
        A function that moves processes into the group; their later children are in it too.

    Raises:
        RuntimeError: Control groups cannot be created.
    """
    parent, write_limit = _find_cpu_cgroup()
    try:
        group = Path(mkdtemp(prefix="slow-machine-", dir=parent))
        write_limit(group, round(percent / 100.0 * PERIOD_US))
    except OSError as error:
        raise RuntimeError(
            f"{parent}: cannot create a control group: {error}; run as root"
        ) from error
    try:
        yield lambda processes: _move(processes, group)
    finally:
        _remove_cgroup(group, parent)


def _find_cpu_cgroup() -> tuple[Path, Callable[[Path, int], None]]:
    """Return the top group of the cpu controller, and the function that writes a limit."""
    first = Path("/sys/fs/cgroup/cpu")
    if (first / "cpu.shares").exists():
        return first, _write_cgroup_v1
    return Path("/sys/fs/cgroup"), _write_cgroup_v2


def _write_cgroup_v1(group: Path, quota_us: int) -> None:
    (group / "cpu.cfs_period_us").write_text(str(PERIOD_US))
    (group / "cpu.cfs_quota_us").write_text(str(quota_us))


def _write_cgroup_v2(group: Path, quota_us: int) -> None:
    (group / "cpu.max").write_text(f"{quota_us} {PERIOD_US}")


def _remove_cgroup(group: Path, parent: Path) -> None:
    """Remove a group; retry, because ending processes hold it for a moment."""
    deadline_s = time.monotonic() + STOP_TIMEOUT_S
    while True:
        _move(map(int, (group / "cgroup.procs").read_text().split()), parent)
        try:
            group.rmdir()
        except OSError:
            if time.monotonic() > deadline_s:
                raise
            time.sleep(0.1)
        else:
            return


def _move(processes: Iterable[int], group: Path) -> None:
    for process in processes:
        try:
            (group / "cgroup.procs").write_text(str(process))
        except ProcessLookupError:
            continue  # the process has ended

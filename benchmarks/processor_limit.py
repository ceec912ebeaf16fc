"""A limit on the processor time of running processes, as systemd's CPUQuota: by a control group."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import mkdtemp

PERIOD_US = 100_000  # systemd's own
STOP_TIMEOUT_S = 10.0


@contextmanager
def limit_processor(percent: float) -> Iterator[Callable[[Iterable[int]], None]]:
    """A group whose processes together get so much of one processor.

    Yields what puts processes into it; what they start later is in it too. At the end they go back
    to where this process is not limited either. Raises RuntimeError where groups cannot be made.
    """
    parent, write_limit = _find_cpu_cgroup()
    try:
        group = Path(mkdtemp(prefix="slow-machine-", dir=parent))
        write_limit(group, round(percent / 100.0 * PERIOD_US))
    except OSError as error:
        raise RuntimeError(f"{parent}: no control group can be made: {error}; be root") from error
    try:
        yield lambda processes: _move(processes, group)
    finally:
        _remove_cgroup(group, parent)


def _find_cpu_cgroup() -> tuple[Path, Callable[[Path, int], None]]:
    """The top group of the processor's controller, and how a limit is written there."""
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
    """Processes that are ending hold a group for a moment longer."""
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
            continue  # it has ended

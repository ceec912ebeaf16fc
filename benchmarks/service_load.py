"""CPU use of processes, and its limit by a control group."""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

from tests.resource_leaks import child_pids_of

PERIOD_US = 100_000  # as systemd
STOP_TIMEOUT_S = 10.0


@dataclass(frozen=True)
class ProcessorUse:
    """Processor seconds so far, by process and of the whole machine."""

    by_process: Mapping[int, float]
    stolen_s: float
    total_s: float

    def since(self, before: "ProcessorUse") -> "ProcessorUse":
        """Return the use since `before`; 0 for a process that has ended."""
        spent = {
            process: max(0.0, used_s - before.by_process.get(process, 0.0))
            for process, used_s in self.by_process.items()
        }
        return ProcessorUse(spent, self.stolen_s - before.stolen_s, self.total_s - before.total_s)

    @property
    def steal_percent(self) -> float:
        """Percentage of the machine's time that its host gave to others."""
        return 100.0 * self.stolen_s / self.total_s if self.total_s else 0.0


def measure_processor_use(*processes: int) -> ProcessorUse:
    """Measure the use of processes, with all their threads."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    ticks = [int(field) for field in fields[:8]]  # user nice system idle iowait irq softirq steal
    per_second = 100.0  # USER_HZ
    by_process = {process: _cpu_s(process) for process in processes}
    return ProcessorUse(by_process, ticks[7] / per_second, sum(ticks) / per_second)


def descendants_of(process: int) -> list[int]:
    """Process numbers of all descendants of a process."""
    children = child_pids_of(process)
    return children + [each for child in children for each in descendants_of(child)]


def _cpu_s(process: int) -> float:
    """Processor time of all threads of a process; 0 once it has ended."""
    try:
        # Clock number as in clock_getcpuclockid(3).
        return time.clock_gettime(~process << 3 | 2)
    except OSError:
        return 0.0


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

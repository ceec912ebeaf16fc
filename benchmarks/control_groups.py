"""Control groups that limit the processor time and the memory of processes. They need root."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp

PERIOD_US = 100_000  # as systemd
REMOVAL_TIMEOUT_S = 10.0
CGROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class ControlGroup:
    """A group of processes with limits; its folders, that of the processor's limit first."""

    folders: Sequence[Path]

    def add(self, processes: Sequence[int]) -> None:
        """Move processes into the group; their later children are in it too."""
        for folder in self.folders:
            _move(processes, folder)

    @property
    def throttled_s(self) -> float:
        """Time so far in which processes waited although a processor was free."""
        fields = (self.folders[0] / "cpu.stat").read_text().split()
        values = dict(zip(fields[::2], map(int, fields[1::2]), strict=True))
        if "throttled_usec" in values:
            return 1e-6 * values["throttled_usec"]
        return 1e-9 * values["throttled_time"]


@contextmanager
def limit_processes(percent: float, memory_mb: int | None = None) -> Iterator[ControlGroup]:
    """Create a control group whose processes together have limits.

    At the end its processes return to the top group.

    Args:
        percent: Processor time, in percent of one processor.
        memory_mb: Memory that they allocate in the group; None: no limit.

    Yields:
        The group, still empty.

    Raises:
        RuntimeError: Control groups cannot be created.
    """
    limits = _limits(round(percent / 100.0 * PERIOD_US), memory_mb)
    with ExitStack() as stack:
        groups = []
        for parent, values in limits.items():
            try:
                group = Path(mkdtemp(prefix="limited-", dir=parent))
                stack.callback(_remove, group, parent)
                for name, value in values.items():
                    (group / name).write_text(value)
            except OSError as error:
                raise RuntimeError(
                    f"{parent}: cannot create a control group: {error}; run as root"
                ) from error
            groups.append(group)
        yield ControlGroup(groups)


def _limits(quota_us: int, memory_mb: int | None) -> Mapping[Path, Mapping[str, str]]:
    """Values of the files of a group, by its parent: the first version has one per controller."""
    quota = {"cpu.cfs_period_us": str(PERIOD_US), "cpu.cfs_quota_us": str(quota_us)}
    memory_bytes = None if memory_mb is None else str(memory_mb * 1_000_000)
    match (CGROUPS / "cpu" / "cpu.shares").exists(), memory_bytes:
        case True, None:
            return {CGROUPS / "cpu": quota}
        case True, str():
            memory = {"memory.limit_in_bytes": memory_bytes}
            return {CGROUPS / "cpu": quota, CGROUPS / "memory": memory}
        case _:
            limits = {"cpu.max": f"{quota_us} {PERIOD_US}", "memory.max": memory_bytes or "max"}
            return {CGROUPS: limits}


def _remove(group: Path, parent: Path) -> None:
    """Remove a group; retry, because ending processes hold it for a moment."""
    deadline_s = time.monotonic() + REMOVAL_TIMEOUT_S
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

"""Processor time of running processes, and what the machine took away from all of them."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.resource_leaks import child_pids_of


@dataclass(frozen=True)
class ProcessorUse:
    """Seconds so far: by process, and of the whole machine."""

    by_process: Mapping[int, float]
    stolen_s: float
    total_s: float

    def since(self, before: "ProcessorUse") -> "ProcessorUse":
        """What was used from `before` until now; nothing by a process that has ended meanwhile."""
        spent = {
            process: max(0.0, used_s - before.by_process.get(process, 0.0))
            for process, used_s in self.by_process.items()
        }
        return ProcessorUse(spent, self.stolen_s - before.stolen_s, self.total_s - before.total_s)

    @property
    def steal_percent(self) -> float:
        """Share of the machine's time that its host gave to others."""
        return 100.0 * self.stolen_s / self.total_s if self.total_s else 0.0


def measure_processor_use(*processes: int) -> ProcessorUse:
    """Of these processes, all their threads together."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    ticks = [int(field) for field in fields[:8]]  # user nice system idle iowait irq softirq steal
    per_second = 100.0  # USER_HZ
    by_process = {process: _cpu_s(process) for process in processes}
    return ProcessorUse(by_process, ticks[7] / per_second, sum(ticks) / per_second)


def descendants_of(process: int) -> list[int]:
    """Process numbers of its children, theirs, and so on."""
    children = child_pids_of(process)
    return children + [each for child in children for each in descendants_of(child)]


def _cpu_s(process: int) -> float:
    """Of all its threads; 0 once it has ended."""
    try:
        # The clock's number as in clock_getcpuclockid(3).
        return time.clock_gettime(~process << 3 | 2)
    except OSError:
        return 0.0

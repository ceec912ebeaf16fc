"""Processor time of running processes, and the time stolen by the machine's host."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.resource_leaks import child_pids_of


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

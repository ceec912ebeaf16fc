"""Processor time and memory of running processes."""

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.resource_leaks import child_pids_of


@dataclass(frozen=True)
class Load:
    """Use of the processors by some processes and all their descendants.

    Attributes:
        seconds: Duration.
        cpu_s: Processor seconds by process, with all its threads.
        steal_percent: Percentage of the machine's time that its host gave to others.
    """

    seconds: float
    cpu_s: Mapping[int, float]
    steal_percent: float

    def percent(self, *processes: int) -> float:
        """Percentage of one core that these processes used; by default all."""
        return 100.0 * sum(self.cpu_s[each] for each in processes or self.cpu_s) / self.seconds

    def percent_without(self, process: int) -> float:
        """The same of all other processes."""
        return self.percent() - self.percent(process)

    def per_frame_ms(self, frames: int, *processes: int) -> float:
        """Milliseconds per frame of these processes together; by default of all."""
        return 10.0 * self.percent(*processes) * self.seconds / frames


class LoadMeter:
    """Measures the load of processes and their descendants, from now on."""

    def __init__(self, *processes: int) -> None:
        self._processes, self._begin_s = processes, time.monotonic()
        self._cpu_s, self._machine = self._measure(), _machine_ticks()

    def read(self) -> Load:
        """Return the load so far; that of processes which have ended is not known."""
        cpu_s = {
            process: max(0.0, used_s - self._cpu_s.get(process, 0.0))
            for process, used_s in self._measure().items()
        }
        stolen, total = (
            now - before for now, before in zip(_machine_ticks(), self._machine, strict=True)
        )
        steal_percent = 100.0 * stolen / total if total else 0.0
        return Load(time.monotonic() - self._begin_s, cpu_s, steal_percent)

    def _measure(self) -> dict[int, float]:
        descendants = [each for process in self._processes for each in descendants_of(process)]
        return {process: _cpu_s(process) for process in (*self._processes, *descendants)}


def descendants_of(process: int) -> list[int]:
    """Process numbers of all descendants of a process."""
    children = child_pids_of(process)
    return children + [each for child in children for each in descendants_of(child)]


def memory_mb(process: int, kind: str) -> float:
    """Return a kind of memory of a process, MB: "VmRSS", "RssAnon", or "Pss", its share of all."""
    file = "smaps_rollup" if kind == "Pss" else "status"
    text = Path(f"/proc/{process}/{file}").read_text()
    size = re.search(rf"(?m)^{kind}:\s+(\d+) kB$", text)
    assert size is not None
    return int(size[1]) / 1e3


def _cpu_s(process: int) -> float:
    """Processor time of all threads of a process; 0 once it has ended."""
    try:
        # Clock number as in clock_getcpuclockid(3).
        return time.clock_gettime(~process << 3 | 2)
    except OSError:
        return 0.0


def _machine_ticks() -> tuple[int, int]:
    """Time so far that the host gave to others, and all time."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:]
    ticks = [int(field) for field in fields[:8]]  # user nice system idle iowait irq softirq steal
    return ticks[7], sum(ticks)

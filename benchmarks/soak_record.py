"""The samples of a soak test, stored in a file, and checks for growth."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from drivers.core.geometry import Array

SLOPE_FRAMES = 10_000


@dataclass(frozen=True)
class SoakSample:
    """One sample of the service.

    Attributes:
        run: Number of earlier starts of the service.
        frame: Poses received since this start.
        seconds: Seconds since this start.
        service_mb: Resident memory of the service's process.
        others_mb: Resident memory of its children together; shared memory counts in both.
        handles: Open files of the service.
        threads: Threads of the service.
        children: Number of its descendants.
        p50_ms: Median latency since the last sample, from a frame's arrival to its received pose.
        p99_ms: 99th percentile of that latency.
        cpu_ms: Processor time per frame since the last sample, all processes together.
        dropped: Frames that the odometry missed since this start.
        lost: Poses that the subscriber missed since this start.
    """

    run: int
    frame: int
    seconds: float
    service_mb: float
    others_mb: float
    handles: int
    threads: int
    children: int
    p50_ms: float
    p99_ms: float
    cpu_ms: float
    dropped: int
    lost: int


@dataclass(frozen=True)
class SoakCheck:
    """One figure and its limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def is_within_limit(self) -> bool:
        """Whether the value is within the limit."""
        return self.value <= self.limit


@dataclass
class SoakRecord:
    """All samples in their order."""

    file: Path
    samples: list[SoakSample] = field(default_factory=list)

    @classmethod
    def load(cls, file: Path) -> "SoakRecord":
        """Load the samples of a file; an empty record if there is none."""
        if not file.exists():
            return cls(file)
        return cls(file, [SoakSample(**each) for each in json.loads(file.read_text())])

    def add(self, sample: SoakSample) -> None:
        """Add a sample and store it, so that an interruption loses nothing."""
        self.samples.append(sample)
        part = self.file.with_name(self.file.name + ".part")
        part.write_text(json.dumps([asdict(each) for each in self.samples]))
        part.replace(self.file)

    @property
    def runs(self) -> int:
        """Number of starts of the service."""
        return self.samples[-1].run + 1 if self.samples else 0

    @property
    def frames(self) -> int:
        """Number of received poses in all runs."""
        return sum(self._of_run(run)[-1].frame for run in range(self.runs))

    def after_warm_up(self, warm_up: int) -> list[SoakSample]:
        """Samples without each run's first frames."""
        return [sample for sample in self.samples if sample.frame > warm_up]

    def _of_run(self, run: int) -> list[SoakSample]:
        return [sample for sample in self.samples if sample.run == run]


def check_soak(record: SoakRecord, warm_up: int) -> list[SoakCheck]:
    """Check that memory, handles, threads and latency are constant, and that nothing was lost.

    Raises:
        ValueError: A run has fewer than three samples after its warm-up.
    """
    warm = record.after_warm_up(warm_up)
    if len(warm) < 3:
        raise ValueError("too few samples after the warm-up")
    p50_ms, p99_ms = (growth(warm, what) for what in (_p50_ms, _p99_ms))
    return [
        SoakCheck("memory of the service", slope(warm, lambda s: s.service_mb), 1.0, "MB/10,000"),
        SoakCheck("memory of its children", slope(warm, lambda s: s.others_mb), 1.0, "MB/10,000"),
        SoakCheck("open handles", slope(warm, lambda s: s.handles), 0.5, "/10,000"),
        SoakCheck("threads", slope(warm, lambda s: s.threads), 0.5, "/10,000"),
        SoakCheck("children", slope(warm, lambda s: s.children), 0.1, "/10,000"),
        SoakCheck("latency, median, end to start", p50_ms, 1.2, "times"),
        SoakCheck("latency, 99 %, end to start", p99_ms, 1.5, "times"),
        SoakCheck("poses lost in transmission", sum(_last_values(record, lambda s: s.lost)), 0, ""),
    ]


def slope(samples: Sequence[SoakSample], value: Callable[[SoakSample], float]) -> float:
    """Growth in 10,000 frames: least squares over all runs, each with its own offset."""
    frames = _center(samples, lambda sample: sample.frame)
    values = _center(samples, value)
    spread = float(frames @ frames)
    return SLOPE_FRAMES * float(frames @ values) / spread if spread else 0.0


def growth(samples: Sequence[SoakSample], value: Callable[[SoakSample], float]) -> float:
    """Ratio of the median of the last third to that of the first."""
    third = max(1, len(samples) // 3)
    first, last = (
        [value(sample) for sample in part] for part in (samples[:third], samples[-third:])
    )
    return float(np.median(last) / np.median(first))


def _center(samples: Sequence[SoakSample], what: Callable[[SoakSample], float]) -> Array:
    """Values of each run minus their mean."""
    runs = np.array([sample.run for sample in samples])
    values = np.array([what(sample) for sample in samples], np.float64)
    for run in np.unique(runs):
        values[runs == run] -= values[runs == run].mean()
    return values


def _last_values(record: SoakRecord, what: Callable[[SoakSample], float]) -> list[float]:
    """The last value of each run."""
    last = {sample.run: what(sample) for sample in record.samples}
    return list(last.values())


def _p50_ms(sample: SoakSample) -> float:
    return sample.p50_ms


def _p99_ms(sample: SoakSample) -> float:
    return sample.p99_ms

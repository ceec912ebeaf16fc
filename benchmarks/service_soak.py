"""Soak test of the whole service for hundreds of thousands of frames: growth of its resources.

    python -m benchmarks service_soak STATE.json [--frames 200000] [--rate 60] [--plot FILE.png]

The real `kinect-vo run` plays the virtual Kinect's 300 frames in a loop at `--rate`. A subscriber
receives every pose, the viewer records into rotating files, and the flight recorder runs. Every
1000 frames a sample is taken: memory, open handles, threads, children, latency, processor time.

Samples are stored in STATE.json at once. After an interruption (Ctrl-C, a crash, a reboot) the same
command starts the service again and continues until all poses are received. Slopes are fitted over
all runs, each with its own offset and without its warm-up. Exit code 1 if memory grows by 1 MB or
more in 10,000 frames, or another resource is not constant.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from benchmarks.service_load import descendants_of, measure_processor_use, wall_clock_offset_s
from drivers.core.files import cache_folder
from drivers.core.geometry import Array
from drivers.synthetic import SyntheticConfig
from drivers.synthetic.frame_provider import render_all
from tests.resource_leaks import count_open_files_of, is_alive, resident_memory_kb
from tests.vo_service.service_process import ServiceProcess, running_service
from vo_service.config import read_config
from vo_service.terminal import Terminal

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


PlottedFigure = tuple[str, Callable[[SoakSample], float]]
PANELS: tuple[tuple[str, tuple[PlottedFigure, ...]], ...] = (
    (
        "memory, MB",
        (("service", lambda s: s.service_mb), ("its children", lambda s: s.others_mb)),
    ),
    (
        "count",
        (
            ("open handles", lambda s: s.handles),
            ("threads", lambda s: s.threads),
            ("children", lambda s: s.children),
        ),
    ),
    ("latency, ms", (("median", lambda s: s.p50_ms), ("99 %", lambda s: s.p99_ms))),
    ("CPU, ms per frame", (("all processes", lambda s: s.cpu_ms),)),
)
SAMPLE_FRAMES = 1000
# The service stores the processor times of its last 20,000 frames; until then its memory grows.
WARM_UP_FRAMES = 25_000
SEQUENCE_FRAMES = 300
# A busy machine may be slower than the frame rate by this factor.
TIMEOUT_FACTOR = 10.0

CONFIG = """
[rerun]
targets = ["{folder}/viewer.rrd"]
file_mb = 50
files_kept = 2
[recorder]
folder = "{folder}/incidents"
total_mb = 100
[map]
max_mb = 10
[load]
adapt = false
[synthetic]
rate_hz = {rate}
duration_s = {duration_s}
loop = true
texel_m = 0.004
color = {{ distortion = [0.0, 0.0, 0.0, 0.0, 0.0], exposure_s = 0.0, smooth_edges = false }}
timing = {{ readout_s = 0.0, skew_s = 0.0 }}
"""


def save_plot(record: SoakRecord, file: Path) -> None:
    """Plot all samples; dotted lines mark restarts of the service."""
    mpl.use("Agg")
    from matplotlib import pyplot

    before = [sum(s.frame for s in _run_ends(record)[:run]) for run in range(record.runs)]
    at = [(before[sample.run] + sample.frame) / 1000 for sample in record.samples]
    figure, axes = pyplot.subplots(len(PANELS), 1, sharex=True, figsize=(8, 9), layout="tight")
    for axis, (label, lines) in zip(axes, PANELS, strict=True):
        _draw(axis, label, lines, at, record)
        for frames in before[1:]:
            axis.axvline(frames / 1000, color="gray", linestyle=":")
    axes[-1].set_xlabel("thousand frames")
    figure.savefig(file, dpi=100)
    pyplot.close(figure)


def _draw(
    axis: Axes, label: str, lines: tuple[PlottedFigure, ...], at: list[float], record: SoakRecord
) -> None:
    for name, value in lines:
        axis.plot(at, [value(sample) for sample in record.samples], label=name, linewidth=1)
    axis.set_ylabel(label)
    axis.set_ylim(bottom=0)
    axis.grid(visible=True, alpha=0.3)
    axis.legend(loc="lower right", fontsize="small")


def _run_ends(record: SoakRecord) -> list[SoakSample]:
    return list({sample.run: sample for sample in record.samples}.values())


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("state", type=Path, help="file of samples; an existing one is continued")
    parser.add_argument(
        "--frames", type=int, default=200_000, help="total frames (default: 200000)"
    )
    parser.add_argument("--rate", type=float, default=60.0, help="frames per second (default: 60)")
    parser.add_argument(
        "--warm-up",
        type=int,
        default=WARM_UP_FRAMES,
        help="skipped frames of each run (default: 25000)",
    )
    parser.add_argument("--plot", type=Path, help="plot to write")


def main(args: argparse.Namespace) -> int:
    """Run until all poses are received, then evaluate."""
    record = SoakRecord.load(args.state)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = CONFIG.format(
            folder=folder, rate=args.rate, duration_s=SEQUENCE_FRAMES / args.rate
        )
        if record.frames < args.frames:
            prerender_room(folder, config)
            with running_service(folder, {}, source="synthetic", more_config=config) as service:
                SoakRun(service, record, args.rate).run_until(args.frames)
                if service.stop() != 0:
                    raise RuntimeError(f"the service did not exit cleanly: {service.log}")
    if args.plot is not None:
        save_plot(record, args.plot)
    return report(record, args.warm_up)


def prerender_room(folder: Path, config: str) -> None:
    """Render the room into the cache, if needed."""
    file = folder / "room.toml"
    file.write_text(f"schema = 1\n{config}")
    synthetic: SyntheticConfig = read_config(file).synthetic
    progress = Terminal().progress_callback("rendering the room: frame")
    render_all(synthetic, cache_folder() / "sequences", progress).close()


class SoakRun:
    """One run of the service, from its first pose on."""

    def __init__(self, service: ServiceProcess, record: SoakRecord, rate: float) -> None:
        self._service = service
        self._record = record
        self._limit_s = TIMEOUT_FACTOR * SAMPLE_FRAMES / rate
        self._run, self._frame, self._lost = record.runs, 0, 0
        self._wall_s = wall_clock_offset_s()
        service.wait_until_streaming(time.monotonic())
        self._began_s = time.monotonic()
        self._used_s = self._cpu_s()

    def run_until(self, frames: int) -> None:
        """Sample every thousand frames until the record has `frames` frames."""
        subscriber = self._service.received
        while self._record.frames < frames:
            if not subscriber.wait_for(
                lambda: len(subscriber.poses) > SAMPLE_FRAMES, self._limit_s
            ):
                raise RuntimeError(
                    f"the service stopped publishing poses; its log: {self._service.log}"
                )
            self._record.add(self._sample())
            print(f"{self._record.frames} of {frames} frames", file=sys.stderr, flush=True)

    def _sample(self) -> SoakSample:
        subscriber = self._service.received
        # The last pose stays: the next sample counts from it.
        poses = subscriber.poses[: SAMPLE_FRAMES + 1]
        del subscriber.poses[:SAMPLE_FRAMES], subscriber.statuses[:-1]
        latency_ms = [1e3 * (p.receive_time_s - (p.stamp_s - self._wall_s)) for p in poses[1:]]
        p50_ms, p99_ms = np.percentile(latency_ms, (50, 99))
        self._frame += len(poses) - 1
        self._lost += poses[-1].seq - poses[0].seq - (len(poses) - 1)
        used_s, before_s = self._cpu_s(), self._used_s
        self._used_s = used_s
        main, others = self._service.process.pid, descendants_of(self._service.process.pid)
        return SoakSample(
            run=self._run,
            frame=self._frame,
            seconds=time.monotonic() - self._began_s,
            service_mb=resident_memory_kb(main) / 1e3,
            others_mb=sum(resident_memory_kb(each) for each in others if is_alive(each)) / 1e3,
            handles=count_open_files_of(main),
            threads=len(list(Path(f"/proc/{main}/task").iterdir())),
            children=len(others),
            p50_ms=float(p50_ms),
            p99_ms=float(p99_ms),
            cpu_ms=1e3 * (used_s - before_s) / (len(poses) - 1),
            dropped=self._service.status["camera"]["dropped"],
            lost=self._lost,
        )

    def _cpu_s(self) -> float:
        main = self._service.process.pid
        return sum(measure_processor_use(main, *descendants_of(main)).by_process.values())


def report(record: SoakRecord, warm_up: int) -> int:
    """Print the figures; return 1 if one exceeds its limit."""
    last = record.samples[-1]
    print(f"{record.frames} frames in {record.runs} run(s), {len(record.samples)} samples")
    print(
        f"the last: service {last.service_mb:.1f} MB, children {last.others_mb:.1f} MB, "
        f"{last.handles} handles, {last.threads} threads, latency {last.p50_ms:.1f} ms "
        f"(99 %: {last.p99_ms:.1f} ms), CPU {last.cpu_ms:.1f} ms per frame, {last.dropped} dropped"
    )
    judged = check_soak(record, warm_up)
    for each in judged:
        print(
            f"{each.name:32} {each.value:8.3f} {each.unit:10} limit {each.limit:g}  "
            f"{'pass' if each.is_within_limit else 'FAIL'}"
        )
    return 0 if all(each.is_within_limit for each in judged) else 1

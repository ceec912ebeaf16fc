"""Soak tests of the whole service: growth of its resources, and lost frames of a Kinect.

The real `kinect-vo run`, and a separate subscriber that receives every pose.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.harness import Variants, option
from benchmarks.plots import save_panels
from benchmarks.processes import Load, LoadMeter, descendants_of, memory_mb
from benchmarks.simulated_kinect import make_kinect
from benchmarks.streaming_service import streaming_service
from benchmarks.subscriber import wall_clock_offset_s
from drivers.core.files import atomic_write
from drivers.core.geometry import Array
from tests.resource_leaks import command_line_of, count_open_files_of, is_alive
from tests.simulators.kinect_simulator import KinectSimulator
from tests.vo_service.service_process import ServiceProcess, running_service
from tests.vo_service.subscriber import StatusContent, SubscribedPose

SLOPE_FRAMES = 10_000
SAMPLE_FRAMES = 1000
# The service stores the processor times of its last 20,000 frames; until then its memory grows.
WARM_UP_FRAMES = 25_000
SEQUENCE_FRAMES = 300
# A busy machine may be slower than the frame rate by this factor.
TIMEOUT_FACTOR = 10.0
CONFIG = """
[rerun]
targets = ["FOLDER/viewer.rrd"]
file_mb = 50
files_kept = 2
[recorder]
folder = "FOLDER/incidents"
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


WARM_UP_S = 3.0
FIRST_REPORT_S = 60.0
FIRST_WRAP_S = 20.0
TICKS_PER_S = 60_000_000
COUNTERS = (
    ("camera", "dropped"), ("camera", "skipped"), ("camera", "lost_packets"), ("tracking", "failed")
)  # fmt: skip
# Frames in flight when the counters are read.
MAX_IN_FLIGHT = 3


@dataclass(frozen=True)
class SoakSample:
    """One sample of the service.

    Attributes:
        frame: Poses received so far.
        service_mb: Resident memory of the service's process.
        others_mb: Resident memory of its children together; shared memory counts in both.
        handles: Open files of the service.
        threads: Threads of the service.
        children: Number of its descendants.
        p50_ms: Median latency since the last sample, from a frame's arrival to its received pose.
        p99_ms: 99th percentile of that latency.
        cpu_ms: Processor time per frame since the last sample, all processes together.
        dropped: Frames that the odometry missed so far.
        lost: Poses that the subscriber missed so far.
    """

    frame: int
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


class SoakCheck(NamedTuple):
    """One figure and its limit."""

    name: str
    value: float
    limit: float
    unit: str

    @property
    def is_within_limit(self) -> bool:
        return self.value <= self.limit


def check_soak(samples: Sequence[SoakSample], warm_up: int) -> list[SoakCheck]:
    """Check that memory, handles, threads and latency are constant, and that nothing was lost.

    Args:
        samples: In their order.
        warm_up: Frames at the begin that do not count.

    Raises:
        ValueError: There are fewer than three samples after the warm-up.
    """
    warm = [sample for sample in samples if sample.frame > warm_up]
    if len(warm) < 3:
        raise ValueError("too few samples after the warm-up")
    return [
        SoakCheck("memory of the service", slope(warm, "service_mb"), 1.0, "MB/10,000"),
        SoakCheck("memory of its children", slope(warm, "others_mb"), 1.0, "MB/10,000"),
        SoakCheck("open handles", slope(warm, "handles"), 0.5, "/10,000"),
        SoakCheck("threads", slope(warm, "threads"), 0.5, "/10,000"),
        SoakCheck("children", slope(warm, "children"), 0.1, "/10,000"),
        SoakCheck("latency, median, end to start", growth(warm, "p50_ms"), 1.2, "times"),
        SoakCheck("latency, 99 %, end to start", growth(warm, "p99_ms"), 1.5, "times"),
        SoakCheck("poses lost in transmission", samples[-1].lost, 0, ""),
    ]


def slope(samples: Sequence[SoakSample], name: str) -> float:
    """Growth in 10,000 frames, by least squares."""
    frames = values_of(samples, "frame") / SLOPE_FRAMES
    return float(np.polyfit(frames, values_of(samples, name), 1)[0])


def growth(samples: Sequence[SoakSample], name: str) -> float:
    """Ratio of the median of the last third to that of the first."""
    third, values = max(1, len(samples) // 3), values_of(samples, name)
    return float(np.median(values[-third:]) / np.median(values[:third]))


def values_of(samples: Sequence[SoakSample], name: str) -> Array:
    """The figures of all samples."""
    return np.array([getattr(sample, name) for sample in samples], np.float64)


# The lines of each panel of the plot: figures of a sample, by their name in the plot.
PANELS: Mapping[str, Mapping[str, str]] = {
    "memory, MB": {"service": "service_mb", "its children": "others_mb"},
    "count": {"open handles": "handles", "threads": "threads", "children": "children"},
    "latency, ms": {"median": "p50_ms", "99 %": "p99_ms"},
    "CPU, ms per frame": {"all processes": "cpu_ms"},
}


def save_plot(samples: Sequence[SoakSample], file: Path) -> None:
    """Plot all samples."""
    at = values_of(samples, "frame") / 1000
    panels = {
        axis: [(label, at, values_of(samples, name)) for label, name in lines.items()]
        for axis, lines in PANELS.items()
    }
    save_panels(file, "thousand frames", panels)


@option("state", type=Path, help="file of samples to write")
@option("--frames", type=int, default=200_000, help="total frames (default: 200000)")
@option("--rate", type=float, default=60.0, help="frames per second (default: 60)")
@option(
    "--warm-up",
    type=int,
    default=WARM_UP_FRAMES,
    help="frames at the begin that do not count (default: 25000)",
)
@option("--plot", type=Path, help="plot to write")
def soak_service(args: argparse.Namespace) -> int:
    """Growth of the service's resources in hundreds of thousands of frames.

    The service plays the virtual Kinect's 300 frames in a loop at `--rate`. The viewer records into
    rotating files, and the flight recorder runs. Every 1000 frames a sample is taken: memory, open
    handles, threads, children, latency, processor time. STATE.json gets each sample at once. Exit
    code 1 if memory grows by 1 MB or more in 10,000 frames after the warm-up, or another resource
    is not constant.
    """
    config = CONFIG.format(rate=args.rate, duration_s=SEQUENCE_FRAMES / args.rate)
    # A new process: the memory of a fork is in part that of its parent.
    with streaming_service(config, popen=subprocess.Popen) as service:
        samples: list[SoakSample] = []
        for sample in take_soak_samples(service, args.frames, args.rate):
            samples.append(sample)
            atomic_write(args.state, json.dumps(list(map(asdict, samples))).encode())
            print(f"{sample.frame} of {args.frames} frames", file=sys.stderr, flush=True)
        if service.stop() != 0:
            raise RuntimeError(f"the service did not exit cleanly: {service.log}")
    if args.plot is not None:
        save_plot(samples, args.plot)
    return report_growth(samples, args.warm_up)


def take_soak_samples(service: ServiceProcess, frames: int, rate: float) -> Iterator[SoakSample]:
    """Yield a sample every thousand frames, until `frames` poses are received."""
    main, received, wall_s = service.process.pid, service.received, wall_clock_offset_s()
    frame, lost, meter = 0, 0, LoadMeter(main)
    while frame < frames:
        if not received.wait_for(
            lambda: len(received.poses) > SAMPLE_FRAMES, TIMEOUT_FACTOR * SAMPLE_FRAMES / rate
        ):
            raise RuntimeError(f"the service stopped publishing poses; its log: {service.log}")
        # The last pose stays: the next sample counts from it.
        poses = received.poses[: SAMPLE_FRAMES + 1]
        del received.poses[:SAMPLE_FRAMES], received.statuses[:-1]
        latency_ms = [1e3 * (p.receive_time_s - (p.stamp_s - wall_s)) for p in poses[1:]]
        p50_ms, p99_ms = np.percentile(latency_ms, (50, 99))
        frame += SAMPLE_FRAMES
        lost += poses[-1].seq - poses[0].seq - SAMPLE_FRAMES
        others = descendants_of(main)
        load, meter = meter.read(), LoadMeter(main)
        yield SoakSample(
            frame=frame,
            service_mb=memory_mb(main, "VmRSS"),
            others_mb=sum(memory_mb(each, "VmRSS") for each in others if is_alive(each)),
            handles=count_open_files_of(main),
            threads=len(list(Path(f"/proc/{main}/task").iterdir())),
            children=len(others),
            p50_ms=float(p50_ms),
            p99_ms=float(p99_ms),
            cpu_ms=load.per_frame_ms(SAMPLE_FRAMES),
            dropped=service.status["camera"]["dropped"],
            lost=lost,
        )


def report_growth(samples: Sequence[SoakSample], warm_up: int) -> int:
    """Print the figures; return 1 if one exceeds its limit."""
    last = samples[-1]
    print(f"{last.frame} frames, {len(samples)} samples")
    print(
        f"the last: service {last.service_mb:.1f} MB, children {last.others_mb:.1f} MB, "
        f"{last.handles} handles, {last.threads} threads, latency {last.p50_ms:.1f} ms "
        f"(99 %: {last.p99_ms:.1f} ms), CPU {last.cpu_ms:.1f} ms per frame, {last.dropped} dropped"
    )
    checks = check_soak(samples, warm_up)
    for each in checks:
        print(
            f"{each.name:32} {each.value:8.3f} {each.unit:10} limit {each.limit:g}  "
            f"{'pass' if each.is_within_limit else 'FAIL'}"
        )
    return 0 if all(each.is_within_limit for each in checks) else 1


@option("--minutes", type=float, default=10.0, help="duration (default: 10)")
@option("--recording", type=Path, metavar="FOLDER", help="what the Kinect sees")
def soak_kinect(args: argparse.Namespace) -> int:
    """Lost frames, CPU time and memory of the whole service on a simulated Kinect.

    The service runs at 30 frames per second, with the flight recorder and without a viewer. The
    Kinect plays a short rendered sequence, or a recording, forwards and backwards. Its clock wraps
    a third into the run, or 20 s into a long one, and every 71.6 s after that. Like a real bus, the
    simulator loses packets of a driver that is late by 32 ms. Exit code 1 if any frame is lost.
    """
    seconds = 60.0 * args.minutes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with make_kinect(folder, args.recording) as kinect:
            wrap_s = min(FIRST_WRAP_S, seconds / 3) + WARM_UP_S
            kinect.start_ticks = 2**32 - round(wrap_s * TICKS_PER_S)
            with running_service(folder, kinect.environment, popen=subprocess.Popen) as service:
                samples = take_samples(service, kinect, seconds)
                names = {each: process_name(each) for each in samples[-1].memory_mb}
                exit_code = service.stop()
                poses = service.received.poses[samples[0].poses : samples[-1].poses]
    lost = report_lost(samples, poses)
    report_costs(samples, poses, names)
    print(f"the service ended with exit code {exit_code}; {lost} frames lost")
    return 1 if lost or exit_code else 0


@dataclass(frozen=True)
class KinectSample:
    """Counters and costs at one time.

    Attributes:
        load: Of the service and its processes since the first sample.
        sent: Frames that the Kinect has sent.
        poses: Number of received poses.
        status: Received after everything else was read.
        memory_mb: Proportional set size by process: its sum is the memory of all.
    """

    load: Load
    sent: int
    poses: int
    status: StatusContent
    memory_mb: Mapping[int, float]


def take_samples(
    service: ServiceProcess, kinect: KinectSimulator, seconds: float
) -> Sequence[KinectSample]:
    """Return samples at the beginning, after a minute of a longer run, and at the end."""
    service.wait_until_streaming(time.monotonic())
    time.sleep(WARM_UP_S)
    begin_s, meter, samples = time.monotonic(), LoadMeter(service.process.pid), []
    for until_s in (0.0, min(FIRST_REPORT_S, seconds / 2), seconds):
        time.sleep(max(0.0, begin_s + until_s - time.monotonic()))
        load, sent, poses = meter.read(), min(kinect.frames_sent), len(service.received.poses)
        used_mb = {process: memory_mb(process, "Pss") for process in load.cpu_s}
        wait_for_new_status(service)
        samples.append(KinectSample(load, sent, poses, service.status, used_mb))
    return samples


def wait_for_new_status(service: ServiceProcess) -> None:
    """Wait until the next status is received."""
    count = len(service.received.statuses)
    service.wait_for_status(lambda _: len(service.received.statuses) > count)


def report_lost(samples: Sequence[KinectSample], poses: Sequence[SubscribedPose]) -> int:
    """Print the table; return the number of lost frames."""
    first, _, last = samples
    sent, received, seconds = last.sent - first.sent, len(poses), last.load.seconds
    counters: dict[str, int] = {
        name: last.status[group][name] - first.status[group][name] for group, name in COUNTERS
    }
    gaps = sum(b.seq - a.seq - 1 for a, b in pairwise(poses))
    backwards = sum(b.stamp_s <= a.stamp_s for a, b in pairwise(poses))
    print(f"{seconds:.0f} s, {received / seconds:.2f} poses a second")
    counts = {
        "frames sent by the Kinect": sent,
        "poses received": received,
        "dropped: the odometry was late": counters["dropped"],
        "skipped: torn or without a partner": counters["skipped"],
        "packets lost on the bus": counters["lost_packets"],
        "poses lost in transmission": gaps,
        "stamps that went back": backwards,
        "frames without a motion found": counters["failed"],
    }
    for name, count in counts.items():
        print(f"{name:36}{count:8d}")
    missing = max(0, abs(sent - received) - MAX_IN_FLIGHT)
    return max(missing, counters["dropped"] + counters["skipped"] + gaps) + backwards


def process_name(process: int) -> str:
    """The name of a worker by its function: "recorder" for ...recorder.worker:run_recorder."""
    function = next((word for word in command_line_of(process) if ":run" in word), "service")
    package = function.partition(":")[0].removesuffix(".worker").rpartition(".")[2]
    return {"subprocess_camera": "driver"}.get(package, package.removesuffix("_process"))


def report_costs(
    samples: Sequence[KinectSample], poses: Sequence[SubscribedPose], names: Mapping[int, str]
) -> None:
    """Print stamp intervals and latencies; CPU time and memory of each process and of all."""
    interval_ms = 1e3 * np.diff([pose.stamp_s for pose in poses])
    low, middle, high = np.percentile(interval_ms, [1, 50, 99])
    print(
        f"stamp to stamp, ms: min {interval_ms.min():.2f}, 1 % {low:.2f}, median {middle:.2f}, "
        f"99 % {high:.2f}, max {interval_ms.max():.2f}"
    )
    _, early, last = samples
    latency = last.status["latency"]
    print(
        f"latency of the last frames, ms: median {latency['p50_ms']:.1f}, "
        f"99 % {latency['p99_ms']:.1f}"
    )
    for process, name in names.items():
        print(
            f"{name}: {last.load.percent(process):.1f} % of a core; "
            f"{early.memory_mb.get(process, 0.0):.1f} MB after {early.load.seconds:.0f} s, "
            f"{last.memory_mb[process]:.1f} MB at the end"
        )
    all_s = (sum(each.load.cpu_s.values()) for each in (last, early))
    share = (next(all_s) - next(all_s)) / (last.load.seconds - early.load.seconds)
    print(
        f"all processes: {100 * share:.1f} % of a core in the second part; "
        f"{sum(last.memory_mb.values()):.1f} MB"
    )


VARIANTS: Variants = {
    "service": soak_service,
    "kinect": soak_kinect,
}

"""Soak test of the whole service on a simulated Kinect: lost frames, CPU time and memory.

    python -m benchmarks sensor_soak [--minutes 10] [--patient] [--recording FOLDER]

The real `kinect-vo run` at 30 frames per second, with the flight recorder and without a viewer; a
separate subscriber receives every pose and status. The Kinect plays a short rendered sequence, or a
recording, forwards and backwards. Its clock wraps a third into the run, or 20 s into a long one,
and every 71.6 s after that. Like a real bus, the simulator loses packets of a driver that is late
by 32 ms; with --patient it waits, for a busy machine. Exit code 1 if any frame is lost.
"""

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.service_load import descendants_of, measure_processor_use
from tests.resource_leaks import resident_memory_kb
from tests.simulators.frame_sources import folder_frames, write_fitted_usb_frames
from tests.simulators.kinect_simulator import IDENTITY, KinectSimulator, LoopMode
from tests.vo_service.corner_sequence import make_corner_kinect, write_corner_frames
from tests.vo_service.service_process import ServiceProcess, running_service
from tests.vo_service.subscriber import StatusContent, SubscribedPose

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
class SensorSoakSample:
    """Counters and costs at one time."""

    time_s: float
    sent: int
    poses: int
    status: StatusContent
    cpu_s: tuple[float, float, float]  # service, driver, all processes
    memory_kb: tuple[int, int]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--minutes", type=float, default=10.0, help="duration (default: 10)")
    parser.add_argument("--patient", action="store_true", help="lose no packets on the bus")
    parser.add_argument("--recording", type=Path, metavar="FOLDER", help="what the Kinect sees")


def main(args: argparse.Namespace) -> int:
    """Run and print."""
    seconds = 60.0 * args.minutes
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with make_kinect(folder, args.recording) as kinect:
            kinect.waits_for_reader = args.patient
            wrap_s = min(FIRST_WRAP_S, seconds / 3) + WARM_UP_S
            kinect.start_ticks = 2**32 - round(wrap_s * TICKS_PER_S)
            with running_service(folder, kinect.environment) as service:
                samples = soak(service, kinect, seconds)
                exit_code = service.stop()
                poses = service.received.poses[samples[0].poses : samples[-1].poses]
    lost = report(samples, poses)
    print(f"the service ended with exit code {exit_code}; {lost} frames lost")
    return 1 if lost or exit_code else 0


def make_kinect(folder: Path, recording: Path | None) -> KinectSimulator:
    """Make a Kinect that sees a recording or a rendered corner."""
    if recording is None:
        return make_corner_kinect(folder, write_corner_frames(folder))
    usb_frames = write_fitted_usb_frames(folder, folder_frames(recording))
    kinect = KinectSimulator(folder, usb_frames, registration=IDENTITY)
    kinect.loop = LoopMode.THERE_AND_BACK
    return kinect


def soak(
    service: ServiceProcess, kinect: KinectSimulator, seconds: float
) -> Sequence[SensorSoakSample]:
    """Return samples at the beginning, after a minute of a longer run, and at the end."""
    service.wait_until_streaming(time.monotonic())
    time.sleep(WARM_UP_S)
    samples = [take_sample(service, kinect)]
    for until_s in (min(FIRST_REPORT_S, seconds / 2), seconds):
        time.sleep(samples[0].time_s + until_s - time.monotonic())
        samples.append(take_sample(service, kinect))
    return samples


def take_sample(service: ServiceProcess, kinect: KinectSimulator) -> SensorSoakSample:
    """Take a sample, with a status that was received after reading everything else."""
    processes = service.process.pid, service.driver_pid
    at_s, sent, poses = time.monotonic(), min(kinect.frames_sent), len(service.received.poses)
    use = measure_processor_use(processes[0], *descendants_of(processes[0])).by_process
    used_s = use[processes[0]], use[processes[1]], sum(use.values())
    memory_kb = resident_memory_kb(processes[0]), resident_memory_kb(processes[1])
    statuses = len(service.received.statuses)
    service.wait_for_status(lambda _: len(service.received.statuses) > statuses)
    return SensorSoakSample(at_s, sent, poses, service.status, used_s, memory_kb)


def report(samples: Sequence[SensorSoakSample], poses: Sequence[SubscribedPose]) -> int:
    """Print the table; return the number of lost frames."""
    first, early, last = samples
    duration_s = last.time_s - first.time_s
    sent, received = last.sent - first.sent, len(poses)
    counters: dict[str, int] = {
        name: last.status[group][name] - first.status[group][name] for group, name in COUNTERS
    }
    gaps = sum(b.seq - a.seq - 1 for a, b in pairwise(poses))
    backwards = sum(b.stamp_s <= a.stamp_s for a, b in pairwise(poses))
    print(f"{duration_s:.0f} s, {received / duration_s:.2f} poses a second")
    print(f"frames sent by the Kinect           {sent:8d}")
    print(f"poses received                      {received:8d}")
    print(f"dropped: the odometry was late      {counters['dropped']:8d}")
    print(f"skipped: torn or without a partner  {counters['skipped']:8d}")
    print(f"packets lost on the bus             {counters['lost_packets']:8d}")
    print(f"poses lost in transmission          {gaps:8d}")
    print(f"stamps that went back               {backwards:8d}")
    print(f"frames without a motion found       {counters['failed']:8d}")
    report_times(poses, last.status)
    _report_costs(first, early, last)
    missing = max(0, abs(sent - received) - MAX_IN_FLIGHT)
    return max(missing, counters["dropped"] + counters["skipped"] + gaps) + backwards


def report_times(poses: Sequence[SubscribedPose], status: StatusContent) -> None:
    """Print the stamp intervals and the last latencies."""
    interval_ms = 1e3 * np.diff([pose.stamp_s for pose in poses])
    low, middle, high = np.percentile(interval_ms, [1, 50, 99])
    print(
        f"stamp to stamp, ms: min {interval_ms.min():.2f}, 1 % {low:.2f}, median {middle:.2f}, "
        f"99 % {high:.2f}, max {interval_ms.max():.2f}"
    )
    print(
        f"latency of the last frames, ms: median {status['timing']['latency_p50_ms']:.1f}, "
        f"99 % {status['timing']['latency_p99_ms']:.1f}"
    )


def _report_costs(first: SensorSoakSample, early: SensorSoakSample, last: SensorSoakSample) -> None:
    """Print CPU time and memory of both processes, and the CPU time of all."""
    for which, name in enumerate(("service", "driver")):
        share = (last.cpu_s[which] - first.cpu_s[which]) / (last.time_s - first.time_s)
        print(
            f"{name}: {100 * share:.1f} % of a core; "
            f"{early.memory_kb[which] / 1e3:.1f} MB after {early.time_s - first.time_s:.0f} s, "
            f"{last.memory_kb[which] / 1e3:.1f} MB at the end"
        )
    share = (last.cpu_s[2] - early.cpu_s[2]) / (last.time_s - early.time_s)
    print(f"all processes in the second part: {100 * share:.1f} % of a core")

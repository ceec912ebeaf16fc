"""Profiles of the odometry: cost and accuracy, and the service under the limits of a small board.

Each FOLDER is a TUM folder. Times are those of the processor.
"""

import argparse
import os
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks.control_groups import ControlGroup, limit_processes
from benchmarks.harness import FOLDERS, Table, Variants, combine_runs, option, run_in_turn
from benchmarks.processes import LoadMeter, descendants_of, memory_mb
from benchmarks.streaming_service import streaming_service
from benchmarks.tracking import Accuracy, evaluate_accuracy, open_frames_with_truth, track
from tests.vo_service.service_process import NO_MAP_CONFIG, ServiceProcess
from vo_service.odometry.registry import DEFAULT_METHOD, PROFILES, MethodConfig
from vo_service.odometry.warm_up import warm_up

RECORDINGS_TABLE = Table(
    *(34, "frames:8d", "lost:6.0f", "resets:8.0f", "ATE:8.2mm", "RPE 1 s:9.2mm"),
    *("CPU median:12.2f", "mean:8.2f"),
)
BOARD_TABLE = Table(
    *(18, "poses/s:9.2f", "dropped:9d", "service %:11.1f", "workers %:11.1f", "memory MB:11.0f"),
    *("throttled s:13.2f", "steal %:9.1f"),
)
# As in the systemd unit, so that other programs do not matter.
UNIT_NICE = -5
WARM_UP_S = 6.0
# By name: profile and further configuration. Without a map, there is no other process.
BOARD_CASES = {
    f"{profile}{suffix}": (profile, config)
    for suffix, config in (("", ""), (", no map", NO_MAP_CONFIG))
    for profile in PROFILES
}
# The virtual Kinect has 30 frames per second; a second more or less is the measurement's.
MIN_POSES_PER_S = 29.5


@FOLDERS
@option("--starts", type=int, default=3, metavar="N", help="runs of each (default: 3)")
def measure_recordings(args: argparse.Namespace) -> None:
    """Accuracy and CPU time of the method `direct` on recordings, by profile.

    A row has the medians of N runs, which begin with the first, second ... frame. ATE and RPE are
    in millimeters; the CPU milliseconds per frame are those of the odometry, without decoding.
    """
    warm_up(DEFAULT_METHOD, lambda stage: None)
    print(RECORDINGS_TABLE.head)
    for folder in args.folder:
        for profile in PROFILES:
            runs = [run_profile(folder, profile, first) for first in range(args.starts)]
            print(format_runs(f"{folder.name}: {profile}", runs), flush=True)


def run_profile(folder: Path, profile: str, first: int) -> Accuracy:
    """Track a recording from frame `first` on."""
    with open_frames_with_truth(folder) as (frames, truth):
        config = MethodConfig(profile=profile)
        tracked = track(DEFAULT_METHOD, islice(frames, first, None), config=config)
    return evaluate_accuracy(tracked, truth)


def format_runs(name: str, runs: Sequence[Accuracy]) -> str:
    """Format the medians of runs as a row."""
    each = combine_runs(runs, frames=max)
    return RECORDINGS_TABLE.row(
        name,
        *(each.frames, each.failed, each.resets, each.ate_m, each.rpe_1s_m),
        *(each.median_ms, each.cpu_ms),
    )


@dataclass(frozen=True)
class LimitedRun:
    """One run of the service under limits.

    Attributes:
        poses_per_s: Frames that the odometry processed.
        dropped: Frames that it missed.
        service_percent: Processor time of the main process, percent of one processor.
        workers_percent: That of its other processes.
        memory_mb: Proportional set size of all at the end.
        throttled_s: Time in which processes waited because of the limit.
        steal_percent: Of the machine's time that its host gave to others.
    """

    poses_per_s: float
    dropped: int
    service_percent: float
    workers_percent: float
    memory_mb: float
    throttled_s: float
    steal_percent: float


@option("--percent", type=float, default=40.0, help="limit of one processor (default: 40)")
@option("--memory-mb", type=int, default=1000, metavar="MB", help="limit (default: 1000)")
@option("--seconds", type=float, default=60.0, help="duration of a run (default: 60)")
@option("--rounds", type=int, default=3, help="runs of each case (default: 3)")
def measure_board(args: argparse.Namespace) -> int:
    """The service under the limits of a small board, by profile: rate, dropped frames, load.

    `kinect-vo run` on the virtual Kinect at 30 frames per second, with a subscriber outside of the
    limits. From its start on, all its processes together have a part of one processor and of the
    memory (a control group; needs root). The rows are medians of the rounds, `dropped` is the sum.
    The map has a process of its own, whose bursts the limit counts as well. Exit code 1 if the
    small profile without a map misses a frame or is below 29.5 poses per second.
    """
    limits = (args.percent, args.memory_mb, args.seconds)
    runs = run_in_turn(
        {case: partial(run_board, case, *limits) for case in BOARD_CASES}, args.rounds
    )
    results = {
        case: combine_runs(each, dropped=sum, steal_percent=max) for case, each in runs.items()
    }
    print(BOARD_TABLE.head)
    for case, result in results.items():
        print(BOARD_TABLE.row(case, *vars(result).values()))
    least = results["small, no map"]
    return int(least.dropped > 0 or least.poses_per_s < MIN_POSES_PER_S)


def run_board(case: str, percent: float, memory_mb: int, seconds: float) -> LimitedRun:
    """Start the service of a case under limits, warm up, and measure."""
    profile, config = BOARD_CASES[case]
    with limit_processes(percent, memory_mb) as group:
        popen = partial[Any](subprocess.Popen, preexec_fn=partial(_enter, group))
        with streaming_service(config, "--profile", profile, popen=popen) as service:
            time.sleep(WARM_UP_S)
            return measure_limited(service, group, seconds)


def _enter(group: ControlGroup) -> None:
    """Limit this process, before it starts its program."""
    group.add([os.getpid()])
    os.nice(UNIT_NICE)


def measure_limited(service: ServiceProcess, group: ControlGroup, seconds: float) -> LimitedRun:
    """Measure a service in a control group from now on."""
    main = service.process.pid
    before, meter, throttled_s = service.received.statuses[-1], LoadMeter(main), group.throttled_s
    time.sleep(seconds)
    load, after = meter.read(), service.received.statuses[-1]
    frames = after.content["tracking"]["frames"] - before.content["tracking"]["frames"]
    return LimitedRun(
        poses_per_s=frames / (after.receive_time_s - before.receive_time_s),
        dropped=after.content["camera"]["dropped"] - before.content["camera"]["dropped"],
        service_percent=load.percent(main),
        workers_percent=load.percent_without(main),
        memory_mb=sum(memory_mb(each, "Pss") for each in (main, *descendants_of(main))),
        throttled_s=group.throttled_s - throttled_s,
        steal_percent=load.steal_percent,
    )


VARIANTS: Variants = {
    "recordings": measure_recordings,
    "board": measure_board,
}

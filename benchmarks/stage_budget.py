"""CPU time of each stage of the odometry, compared with its budget.

    python -m benchmarks stage_budget FOLDER... [--method direct] [--every 1] [--json]

Each FOLDER is a TUM folder. Times are CPU milliseconds of one thread, without decoding. "mean" is
over all frames: the means add up to the cost of a frame, and the budget is for them. The other
figures are over the frames in which the stage ran. Exit code 1 if a mean exceeds its budget.
"""

import argparse
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.harness import add_json_option, make_printer, print_json
from benchmarks.tracking import read_all_frames
from drivers.camera import PlaybackMode, RgbdFrame
from drivers.core import InputError
from drivers.recording_camera import RecordingCamera
from vo_service.odometry import METHODS, STAGE_BUDGETS_MS, CpuStageTimer, MethodConfig, warm_up

WHOLE_FRAME = "whole frame"
TIMES = ("median", "99 %", "most", "mean", "budget", "share")
HEAD = f"{'stage':<12}{'frames':>8}" + "".join(f"{name:>8}" for name in TIMES)


@dataclass(frozen=True)
class StageTiming:
    """Processor time of a stage, in milliseconds.

    `frames` is the number of frames in which the stage ran; the median, the 99th percentile and the
    maximum are over these. `mean` is over all frames. `budget` is for the mean; None if there is
    none.
    """

    frames: int
    median: float
    p99: float
    max: float
    mean: float
    budget: float | None

    @classmethod
    def from_samples(
        cls, spent_ms: Sequence[float], frames: int, budget_ms: float | None
    ) -> "StageTiming":
        """Summarize the times of a stage in the frames in which it ran."""
        median, p99 = (float(p) for p in np.percentile(spent_ms, (50, 99)))
        mean = sum(spent_ms) / frames
        return cls(len(spent_ms), median, p99, max(spent_ms), mean, budget_ms)

    @property
    def is_over(self) -> bool:
        """Whether the mean exceeds the budget."""
        return self.budget is not None and self.mean > self.budget


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="use every N-th frame")
    add_json_option(parser)


def main(args: argparse.Namespace) -> int:
    """Measure and print."""
    if args.every < 1:
        raise InputError(f"--every {args.every}: must be at least 1")
    warm_up(args.method, lambda stage: None)
    results: dict[str, dict[str, StageTiming]] = {}
    print_line = make_printer(args)
    for folder in args.folder:
        with RecordingCamera(folder, None, PlaybackMode.LOCKSTEP) as camera:
            frames = islice(read_all_frames(camera), None, None, args.every)
            results[str(folder)] = compare_with_budget(
                args.method, list(stage_times(args.method, frames))
            )
        print_line(f"{folder}\n{format_stages(results[str(folder)])}\n")
    print_json(args, results)
    return int(any(spent.is_over for stages in results.values() for spent in stages.values()))


def stage_times(method: str, frames: Iterator[RgbdFrame]) -> Iterator[Mapping[str, float]]:
    """Yield the milliseconds by stage of each frame, including the whole frame."""
    clock = CpuStageTimer()
    odometry = METHODS[method](MethodConfig(), clock)
    for frame in frames:
        begun_s = time.thread_time()
        odometry.estimate(frame)
        whole_ms = (time.thread_time() - begun_s) * 1e3
        yield {**clock.take_stage_ms(), WHOLE_FRAME: whole_ms}


def compare_with_budget(
    method: str, times_ms: Sequence[Mapping[str, float]]
) -> dict[str, StageTiming]:
    """Summarize the times of `stage_times`: stages with a budget first, the whole frame last."""
    budget_ms = STAGE_BUDGETS_MS.get(method, {})
    ran = {stage: None for of_frame in times_ms for stage in of_frame}
    stages = [*budget_ms, *(s for s in ran if s not in budget_ms and s != WHOLE_FRAME), WHOLE_FRAME]
    limits_ms = {**budget_ms, WHOLE_FRAME: sum(budget_ms.values()) or None}
    spent_ms = {stage: [t[stage] for t in times_ms if stage in t] for stage in stages}
    return {
        stage: StageTiming.from_samples(spent, len(times_ms), limits_ms.get(stage))
        for stage, spent in spent_ms.items()
        if spent
    }


def format_stages(stages: Mapping[str, StageTiming]) -> str:
    """Format the table, one line for each stage."""
    lines = [HEAD]
    for stage, spent in stages.items():
        times_ms = (spent.median, spent.p99, spent.max, spent.mean)
        cells = "".join(f"{time_ms:8.2f}" for time_ms in times_ms)
        limit = f"{'-':>8}{'-':>8}"
        if spent.budget is not None:
            limit = f"{spent.budget:8.1f}{spent.mean / spent.budget:8.0%}"
        lines.append(f"{stage:<12}{spent.frames:8d}{cells}{limit}{'  OVER' * spent.is_over}")
    return "\n".join(lines)

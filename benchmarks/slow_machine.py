"""Dropped frames on a machine that is too slow, with and without `load.adapt`.

    python -m benchmarks slow_machine [--percent 60 --percent 40] [--seconds 30] [--rounds 2]

The real `kinect-vo run` on the virtual Kinect at 30 frames per second, with a recording viewer and
a subscriber. Once it runs, all its processes together are limited to a percentage of one processor
(a control group; needs root), with `load.adapt` on and off in turn.

`poses/s` and `dropped` are those of the limited time. `late` are the frames dropped in its second
half, after the load was shed. `shed` is what the status reports at the end. Exit code 1 if
adapting dropped more frames in any case.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from benchmarks.service_latency import prerender_room
from benchmarks.service_load import descendants_of, limit_processor, measure_processor_use
from tests.vo_service.service_process import ServiceProcess, running_service

WARM_UP_S = 6.0
PERCENTS = (75.0, 60.0, 45.0)
VIEWER_PAUSED_TEXT = "the viewer is paused"


@dataclass(frozen=True)
class SlowMachineResult:
    """One run under a limit."""

    poses_per_s: float
    dropped: int
    late: int
    features: int
    degradations: str
    steal_percent: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--percent", type=float, action="append", help="limit, percent of one processor"
    )
    parser.add_argument(
        "--seconds", type=float, default=30.0, help="duration of a run (default: 30)"
    )
    parser.add_argument("--rounds", type=int, default=2, help="runs of each case (default: 2)")


def main(args: argparse.Namespace) -> int:
    """Measure and print."""
    prerender_room()
    percents = args.percent or PERCENTS
    runs: dict[tuple[float, bool], list[SlowMachineResult]] = {}
    for number in range(args.rounds):
        for percent in percents:
            for adapts in (True, False):
                print(
                    f"round {number + 1}: {percent:.0f} %, {adapts=}", file=sys.stderr, flush=True
                )
                runs.setdefault((percent, adapts), []).append(_run(percent, adapts, args.seconds))
    return report(runs)


def _run(percent: float, adapts: bool, seconds: float) -> SlowMachineResult:
    """Start everything, warm up, then limit the processor time and measure."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        config = (
            f"[load]\nadapt = {str(adapts).lower()}\n"
            f'[rerun]\ntargets = ["{folder}/viewer.rrd"]\npicture_hz = 30.0\n'
        )
        with (
            limit_processor(percent) as limit,
            running_service(
                folder / "service", {}, source="synthetic", more_config=config
            ) as service,
        ):
            service.wait_until_streaming(time.monotonic())
            time.sleep(WARM_UP_S)
            limit([service.process.pid, *descendants_of(service.process.pid)])
            return measure(service, seconds)


def measure(service: ServiceProcess, seconds: float) -> SlowMachineResult:
    """Measure for `seconds` from now on."""
    before, machine = service.status, measure_processor_use()
    time.sleep(seconds / 2)
    middle = service.status
    time.sleep(seconds / 2)
    after = service.status
    warnings = [clause for clause in after["warnings"] if VIEWER_PAUSED_TEXT in clause]
    return SlowMachineResult(
        poses_per_s=(after["tracking"]["frames"] - before["tracking"]["frames"]) / seconds,
        dropped=after["camera"]["dropped"] - before["camera"]["dropped"],
        late=after["camera"]["dropped"] - middle["camera"]["dropped"],
        features=after["tracking"]["features"],
        degradations="; ".join(warnings),
        steal_percent=measure_processor_use().since(machine).steal_percent,
    )


def report(runs: dict[tuple[float, bool], list[SlowMachineResult]]) -> int:
    """Print the table; return 1 if adapting did not help."""
    print(
        f"\n{'limit':>6} {'adapt':>5} {'poses/s':>8} {'dropped':>8} {'late':>5} {'features':>8} "
        f"{'steal':>6}  shed"
    )
    for (percent, adapts), outcomes in runs.items():
        print(
            f"{percent:5.0f}% {'yes' if adapts else 'no':>5} "
            f"{mean(each.poses_per_s for each in outcomes):8.1f} "
            f"{mean(each.dropped for each in outcomes):8.0f} "
            f"{mean(each.late for each in outcomes):5.0f} {outcomes[-1].features:8d} "
            f"{max(each.steal_percent for each in outcomes):5.1f}%  "
            f"{outcomes[-1].degradations or '-'}"
        )
    worse = [
        percent
        for percent, adapts in runs
        if adapts and total_dropped(runs[percent, True]) > total_dropped(runs[percent, False])
    ]
    print(f"adapting dropped more: {', '.join(f'{percent:.0f}%' for percent in worse) or 'never'}")
    return 1 if worse else 0


def total_dropped(outcomes: Sequence[SlowMachineResult]) -> int:
    """Number of dropped frames in all runs."""
    return sum(each.dropped for each in outcomes)

"""The service in bad conditions: faults of camera and environment, and too little processor time.

The real `kinect-vo run`, with a subscriber to its status and poses. "report" is from the beginning
of a fault until the status names it, "recovery" from its end until the first pose, or until the
warning ends. Both are in seconds, the slowest of all rounds.
"""

import argparse
import json
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import mean

from benchmarks.control_groups import limit_processes
from benchmarks.harness import Table, Variants, combine_runs, option, run_in_turn
from benchmarks.processes import descendants_of
from benchmarks.profiles import measure_limited
from benchmarks.streaming_service import streaming_service
from drivers.core import UserFacingError
from tests.ports import free_port
from tests.simulators.kinect_simulator import KinectSimulator
from tests.simulators.zenoh_router import running_router
from tests.vo_service.corner_sequence import make_corner_kinect, write_corner_frames
from tests.vo_service.environment_faults import ENVIRONMENT_FAULTS, ServiceEnvironment
from tests.vo_service.environment_faults import run_fault as run_environment_fault
from tests.vo_service.sensor_faults import (
    MAX_RECOVERY_S,
    MAX_REPORT_S,
    NO_KINECT_REASON,
    SENSOR_FAULTS,
    FaultTiming,
    run_fault,
)
from tests.vo_service.service_process import (
    KINECT_VO,
    START_TIMEOUT_S,
    ServiceProcess,
    running_service,
)
from tests.vo_service.service_runner import CAMERA, ServiceRunner, service_runner
from tests.waiting import wait_until

# How much longer each fault of the camera lasts after its report, one round after the other.
DURATIONS_S = (0.0, 1.1, 2.7, 6.0)
FAULT_TABLE = Table(34, "report:8.2f", "limit:7.1f", "recovery:10.2f", "limit:7.1f")
WARM_UP_S = 6.0
PERCENTS = (75.0, 60.0, 45.0)
VIEWER_PAUSED_TEXT = "the viewer is paused"
SLOW_TABLE = Table(8, "adapt:6", "poses/s:9.1f", "dropped:9.0f", "steal %:9.1f")


def slowest_round(rounds: Sequence[FaultTiming]) -> FaultTiming:
    """Return the slowest report and the slowest recovery."""
    return combine_runs(rounds, report_s=max, recovery_s=max)


def measure_camera_faults(args: argparse.Namespace) -> int:
    """Time until the service reports a fault of a Kinect, and until it recovers.

    The Kinect is simulated. The recovery of a killed or stopped driver is from the beginning of the
    fault. Each fault is repeated and lasts up to six seconds after its report. Exit code 1 if a
    limit is exceeded.
    """
    print(FAULT_TABLE.head)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with make_corner_kinect(folder, write_corner_frames(folder)) as kinect:
            kinect.unplug()
            with running_service(folder, kinect.environment) as service:
                plug_in = measure_plug_in(kinect, service)
                limits_s = (MAX_REPORT_S, MAX_RECOVERY_S)
                results = [report_fault("no Kinect at start", plug_in, limits_s)]
                for fault in SENSOR_FAULTS:
                    pauses = [partial(time.sleep, last_s) for last_s in DURATIONS_S]
                    rounds = [run_fault(fault, kinect, service, pause) for pause in pauses]
                    limits_s = (fault.max_report_s, fault.max_recovery_s)
                    results.append(report_fault(fault.name, slowest_round(rounds), limits_s))
                if service.stop() != 0:
                    raise UserFacingError(f"the service did not exit cleanly: {service.log}")
    return 0 if all(results) else 1


def measure_plug_in(kinect: KinectSimulator, service: ServiceProcess) -> FaultTiming:
    """Measure a service that was started without a Kinect."""
    begin_s = time.monotonic()
    reported_s = service.wait_for_reason(NO_KINECT_REASON, begin_s)
    time.sleep(DURATIONS_S[-1])
    end_s = time.monotonic()
    kinect.plug()
    return FaultTiming(reported_s - begin_s, service.wait_until_streaming(end_s) - end_s)


def report_fault(
    name: str, timing: FaultTiming, limits_s: tuple[float, float] | None = None
) -> bool:
    """Print a line; return whether both times are within their limits, if there are any."""
    max_report_s, max_recovery_s = limits_s or (None, None)
    line = FAULT_TABLE.row(name, timing.report_s, max_report_s, timing.recovery_s, max_recovery_s)
    if limits_s is None:
        print(line, flush=True)
        return True
    is_good = timing.report_s <= limits_s[0] and timing.recovery_s <= limits_s[1]
    print(f"{line}  {'pass' if is_good else 'FAIL'}", flush=True)
    return is_good


@option("--rounds", type=int, default=3, help="rounds of each fault (default: 3)")
def measure_environment_faults(args: argparse.Namespace) -> None:
    """Time until the service reports a fault of its environment, and until it recovers.

    It measures the faults of `tests/vo_service/environment_faults.py`, a `kill -9`, and a port in
    use.
    """
    # Compile the kernels first: that is not part of the measured times.
    subprocess.run([KINECT_VO, "warm-up"], check=True)
    print(FAULT_TABLE.head, flush=True)
    # The recorder of a killed service may still write.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        measure_live_faults(folder, args.rounds)
        with service_runner(folder / "own", folder / "sequences") as runner:
            kills = [measure_restart(runner) for _ in range(args.rounds)]
            report_fault("killed, until its first pose", slowest_round(kills))
            runner.service.stop()
            in_use = [measure_port_in_use(runner) for _ in range(args.rounds)]
            report_fault("port taken", slowest_round(in_use))


def measure_live_faults(folder: Path, rounds: int) -> None:
    """Measure all faults of the environment on one service."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    config = f"connect = {json.dumps([endpoint])}\n{CAMERA}"
    with (
        running_router(endpoint) as router,
        service_runner(folder / "around", folder / "sequences", config) as runner,
    ):
        runner.start().wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
        for fault in ENVIRONMENT_FAULTS:
            environment = ServiceEnvironment(runner, router)
            timings = [run_environment_fault(fault, environment) for _ in range(rounds)]
            report_fault(fault.name, slowest_round(timings))
        runner.service.stop()
        runner.check()


def measure_restart(runner: ServiceRunner) -> FaultTiming:
    """Kill the service; measure from the next start, with kernels and room cached, to poses."""
    if runner.has_started:
        runner.service.process.send_signal(signal.SIGKILL)
        runner.service.process.wait()
    begin_s = time.monotonic()
    first_pose_s = runner.start(popen=subprocess.Popen).wait_until_streaming(
        begin_s, START_TIMEOUT_S
    )
    return FaultTiming(0.0, first_pose_s - begin_s)


def measure_port_in_use(runner: ServiceRunner) -> FaultTiming:
    """Measure from the start until the log line, and from the free port until poses."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", runner.port))
        listener.listen()
        begin_s = time.monotonic()
        service = runner.start(popen=subprocess.Popen)
        wait_until(lambda: "the port is in use" in service.log)
        report_s = time.monotonic() - begin_s
    free_s = time.monotonic()
    first_pose_s = service.wait_until_streaming(free_s, START_TIMEOUT_S)
    service.stop()
    return FaultTiming(report_s, first_pose_s - free_s)


@dataclass(frozen=True)
class SlowRun:
    """One run under a limit, and what the status reports at its end."""

    poses_per_s: float
    dropped: int
    steal_percent: float
    shed: str


@option("--percent", type=float, action="append", help="limit, percent of one processor")
@option("--seconds", type=float, default=30.0, help="duration of a run (default: 30)")
@option("--rounds", type=int, default=2, help="runs of each case (default: 2)")
def measure_slow_machine(args: argparse.Namespace) -> int:
    """Dropped frames on a machine that is too slow, with and without `load.adapt`.

    The virtual Kinect at 30 frames per second, with a recording viewer. Once the service runs, all
    its processes together are limited to a percentage of one processor (a control group; needs
    root), with `load.adapt` on and off in turn. `poses/s` and `dropped` are those of the limited
    time. At the end of the line is what the status reports at the end. Exit code 1 if adapting
    dropped more frames in any case.
    """
    cases = {
        (percent, adapts): partial(run_limited, percent, adapts, args.seconds)
        for percent in args.percent or PERCENTS
        for adapts in (True, False)
    }
    runs = run_in_turn(cases, args.rounds)
    print(f"{SLOW_TABLE.head}  shed")
    dropped = {}
    for (percent, adapts), each in runs.items():
        combined = combine_runs(
            each, poses_per_s=mean, dropped=mean, steal_percent=max, shed=lambda texts: texts[-1]
        )
        dropped[percent, adapts] = combined.dropped
        cells = ("yes" if adapts else "no", *vars(combined).values())
        row = SLOW_TABLE.row(f"{percent:.0f} %", *cells[:-1])
        print(f"{row}  {combined.shed or '-'}")
    worse = [
        f"{percent:.0f} %"
        for percent, adapts in runs
        if adapts and dropped[percent, True] > dropped[percent, False]
    ]
    print(f"adapting dropped more: {', '.join(worse) or 'never'}")
    return 1 if worse else 0


def run_limited(percent: float, adapts: bool, seconds: float) -> SlowRun:
    """Start everything, warm up, then limit the processor time and measure."""
    config = (
        f"[load]\nadapt = {str(adapts).lower()}\n"
        '[rerun]\ntargets = ["FOLDER/viewer.rrd"]\npicture_hz = 30.0\n'
    )
    with limit_processes(percent) as group, streaming_service(config) as service:
        time.sleep(WARM_UP_S)
        group.add([service.process.pid, *descendants_of(service.process.pid)])
        run = measure_limited(service, group, seconds)
        warnings = [text for text in service.status["warnings"] if VIEWER_PAUSED_TEXT in text]
    return SlowRun(run.poses_per_s, run.dropped, run.steal_percent, "; ".join(warnings))


VARIANTS: Variants = {
    "camera": measure_camera_faults,
    "environment": measure_environment_faults,
    "slow": measure_slow_machine,
}

"""Time until the service reports a fault of its environment, and until it recovers.

    python -m benchmarks environment_faults [--rounds 3]

It measures the faults of `tests/vo_service/environment_faults.py`, a `kill -9`, and a port in use.
The table has seconds, the slowest of all rounds. "report" is from the fault until a subscriber has
the warning. "recovery" is from the fault's end until the warning ends, or until the first pose.
`benchmarks.sensor_faults` measures the faults of the camera.
"""

import argparse
import json
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from tests.ports import free_port
from tests.simulators.zenoh_router import running_router
from tests.vo_service.environment_faults import ENVIRONMENT_FAULTS, ServiceEnvironment, run_fault
from tests.vo_service.sensor_faults import FaultTiming
from tests.vo_service.service_process import KINECT_VO, START_TIMEOUT_S
from tests.vo_service.service_runner import CAMERA, ServiceRunner, service_runner
from tests.waiting import wait_until

Measurement = Callable[[], FaultTiming]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--rounds", type=int, default=3, help="rounds of each fault (default: 3)")


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    rounds = args.rounds
    # Compile the kernels first: that is not part of the measured times.
    subprocess.run([KINECT_VO, "warm-up"], check=True)
    # The recorder of a killed service may still write.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        print(
            f"{'fault':34} {'report':>8} {'recovery':>8}   seconds, slowest of {rounds}", flush=True
        )
        measure_live_faults(folder, rounds)
        with service_runner(folder / "own", folder / "sequences") as runner:
            report(
                "killed, until its first pose",
                [measure_restart_after_kill(runner) for _ in range(rounds)],
            )
            runner.service.stop()
            report("port taken", [measure_port_in_use(runner) for _ in range(rounds)])


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
            report(fault.name, [run_fault(fault, environment) for _ in range(rounds)])
        runner.service.stop()
        runner.check()


def measure_restart_after_kill(runner: ServiceRunner) -> FaultTiming:
    """Kill the service; measure from the next start, with kernels and room cached, to poses."""
    if runner.has_started:
        runner.service.process.send_signal(signal.SIGKILL)
        runner.service.process.wait()
    begin_s = time.monotonic()
    first_pose_s = runner.start().wait_until_streaming(begin_s, START_TIMEOUT_S)
    return FaultTiming(0.0, first_pose_s - begin_s)


def measure_port_in_use(runner: ServiceRunner) -> FaultTiming:
    """Measure from the start until the log line, and from the free port until poses."""
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(("127.0.0.1", runner.port))
        listener.listen()
        begin_s = time.monotonic()
        service = runner.start()
        wait_until(lambda: "the port is in use" in service.log)
        report_s = time.monotonic() - begin_s
    free_s = time.monotonic()
    first_pose_s = service.wait_until_streaming(free_s, START_TIMEOUT_S)
    service.stop()
    return FaultTiming(report_s, first_pose_s - free_s)


def report(name: str, timings: list[FaultTiming]) -> None:
    """Print the slowest times."""
    report_s, recovery_s = (
        max(each.report_s for each in timings),
        max(each.recovery_s for each in timings),
    )
    print(f"{name:34} {report_s:8.2f} {recovery_s:8.2f}", flush=True)

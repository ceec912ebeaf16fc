"""How long the service needs to say what went wrong around it, and to be well again afterwards.

    python -m benchmarks.environment_faults [--rounds 3]

The faults of `tests/vo_service/environment_faults.py`, a death by `kill -9`, and a port that is taken; in
seconds, the slowest of all rounds. "said" runs from the fault to the warning in a subscriber's
hands, "well" from its end to the warning's end, or to the first pose. The faults of the camera are
measured by `benchmarks.sensor_faults`.
"""

import argparse
import json
import signal
import socket
import subprocess
import sys
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


def main() -> int:
    """Measure and print; see the module."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.environment_faults",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rounds", type=int, default=3, help="of each (default: 3)")
    rounds = parser.parse_args().rounds
    # Kernels that a service has to compile first would say nothing of the faults.
    subprocess.run([KINECT_VO, "warm-up"], check=True)
    # What is killed may leave a recorder that still writes.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name:
        folder = Path(name)
        print(f"{'fault':34} {'said':>6} {'well':>6}   seconds, slowest of {rounds}", flush=True)
        measure_live_faults(folder, rounds)
        with service_runner(folder / "own", folder / "films") as stage:
            report(
                "killed, until its first pose",
                [measure_restart_after_kill(stage) for _ in range(rounds)],
            )
            stage.service.stop()
            report("port taken", [measure_port_in_use(stage) for _ in range(rounds)])
    return 0


def measure_live_faults(folder: Path, rounds: int) -> None:
    """All of these on one service."""
    router_at = f"tcp/127.0.0.1:{free_port()}"
    config = f"connect = {json.dumps([router_at])}\n{CAMERA}"
    with (
        running_router(router_at) as router,
        service_runner(folder / "around", folder / "films", config) as stage,
    ):
        stage.start().wait_until_streaming(time.monotonic(), START_TIMEOUT_S)
        for fault in ENVIRONMENT_FAULTS:
            around = ServiceEnvironment(stage, router)
            report(fault.name, [run_fault(fault, around) for _ in range(rounds)])
        stage.service.stop()
        stage.check()


def measure_restart_after_kill(stage: ServiceRunner) -> FaultTiming:
    """From the start of the next one, kernels and room at hand, until poses are heard."""
    if stage.has_started:
        stage.service.process.send_signal(signal.SIGKILL)
        stage.service.process.wait()
    begin_s = time.monotonic()
    heard_s = stage.start().wait_until_streaming(begin_s, START_TIMEOUT_S)
    return FaultTiming(0.0, heard_s - begin_s)


def measure_port_in_use(stage: ServiceRunner) -> FaultTiming:
    """From the start until the log says so; from when the port is free until poses are heard."""
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", stage.port))
        taken.listen()
        begin_s = time.monotonic()
        service = stage.start()
        wait_until(lambda: "the port is in use" in service.log)
        told_s = time.monotonic() - begin_s
    free_s = time.monotonic()
    heard_s = service.wait_until_streaming(free_s, START_TIMEOUT_S)
    service.stop()
    return FaultTiming(told_s, heard_s - free_s)


def report(name: str, timings: list[FaultTiming]) -> None:
    """Print the slowest of each."""
    told_s, back_s = (
        max(each.report_s for each in timings),
        max(each.recovery_s for each in timings),
    )
    print(f"{name:34} {told_s:6.2f} {back_s:6.2f}", flush=True)


if __name__ == "__main__":
    sys.exit(main())

"""Time until the service reports a fault of a Kinect, and until it recovers.

    python -m benchmarks sensor_faults

The real `kinect-vo run` uses a simulated Kinect; a separate subscriber receives status and poses.
`report` is from the beginning of the fault until a status names it. `recovery` is from its end
until the first pose; for a killed or stopped driver, from its beginning. Each fault is repeated and
lasts up to six seconds after its report. The table has the slowest times in seconds.
"""

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

from drivers.core import UserFacingError
from tests.simulators.kinect_simulator import KinectSimulator
from tests.vo_service.corner_sequence import make_corner_kinect, write_corner_frames
from tests.vo_service.sensor_faults import (
    MAX_RECOVERY_S,
    MAX_REPORT_S,
    NO_KINECT_REASON,
    SENSOR_FAULTS,
    FaultTiming,
    SensorFault,
    run_fault,
)
from tests.vo_service.service_process import ServiceProcess, running_service

# How much longer each fault lasts after its report, one repetition after the other.
DURATIONS_S = (0.0, 1.1, 2.7, 6.0)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""


def main(args: argparse.Namespace) -> int:
    """Measure and print; return 1 if a limit is exceeded."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with make_corner_kinect(folder, write_corner_frames(folder)) as kinect:
            is_good = measure(folder, kinect)
    return 0 if is_good else 1


def measure(folder: Path, kinect: KinectSimulator) -> bool:
    """Print a line for each fault; return whether all are within their limits."""
    print(f"{'fault':20} {'report':>6} {'limit':>6} {'recovery':>8} {'limit':>6}")
    kinect.unplug()
    with running_service(folder, kinect.environment) as service:
        results = [
            report(
                "no Kinect at start", measure_plug_in(kinect, service), MAX_REPORT_S, MAX_RECOVERY_S
            )
        ]
        for fault in SENSOR_FAULTS:
            pauses = [partial(time.sleep, last_s) for last_s in DURATIONS_S]
            slowest = slowest_round([run_fault(fault, kinect, service, pause) for pause in pauses])
            results.append(report_fault(fault, slowest))
        if service.stop() != 0:
            raise UserFacingError(f"the service did not exit cleanly: {service.log}")
    return all(results)


def measure_plug_in(kinect: KinectSimulator, service: ServiceProcess) -> FaultTiming:
    """Measure a service that was started without a Kinect."""
    begin_s = time.monotonic()
    reported_s = service.wait_for_reason(NO_KINECT_REASON, begin_s)
    time.sleep(DURATIONS_S[-1])
    end_s = time.monotonic()
    kinect.plug()
    return FaultTiming(reported_s - begin_s, service.wait_until_streaming(end_s) - end_s)


def slowest_round(rounds: list[FaultTiming]) -> FaultTiming:
    """Return the slowest report and the slowest recovery."""
    return FaultTiming(
        max(each.report_s for each in rounds), max(each.recovery_s for each in rounds)
    )


def report_fault(fault: SensorFault, timing: FaultTiming) -> bool:
    """Print a fault's line; return whether it is within its limits."""
    return report(fault.name, timing, fault.max_report_s, fault.max_recovery_s)


def report(name: str, timing: FaultTiming, max_report_s: float, max_recovery_s: float) -> bool:
    """Print a line; return whether it is within the limits.

    Args:
        name: Name of the fault.
        timing: Measured times.
        max_report_s: Limit of the time until the report, s.
        max_recovery_s: Limit of the time until the recovery, s.
    """
    is_good = timing.report_s <= max_report_s and timing.recovery_s <= max_recovery_s
    print(
        f"{name:20} {timing.report_s:6.2f} {max_report_s:6.1f} {timing.recovery_s:8.2f} "
        f"{max_recovery_s:6.1f}  {'pass' if is_good else 'FAIL'}",
        flush=True,
    )
    return is_good

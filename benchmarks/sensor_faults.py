"""How soon the service says what is wrong with a Kinect, and how soon it has frames again.

    python -m benchmarks.sensor_faults

The real `kinect-vo run` on a played Kinect; a subscriber of its own hears the status and the poses.
`told` is from the fault's beginning until a status names it; `back` from its end until the first
pose, for a driver that was killed or stopped from the beginning. Each fault comes several times,
and lasts up to six seconds after it was named; the slowest counts. Seconds.
"""

import argparse
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from drivers.errors import UserFacingError
from tests.stand_ins.played_kinect import PlayedKinect
from tests.vo_service.corner_film import corner_film, corner_kinect
from tests.vo_service.played_service import PlayedService, running_service
from tests.vo_service.service_faults import (
    BACK_S,
    FAULTS,
    GONE,
    TOLD_S,
    Passed,
    ServiceFault,
    pass_through,
)

# How much longer each fault lasts once it has been named: one after the other.
LASTING_S = (0.0, 1.1, 2.7, 6.0)


def main() -> int:
    """Measure and print; 1 if a limit is missed."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.sensor_faults",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with corner_kinect(folder, corner_film(folder)) as kinect:
            is_good = measure(folder, kinect)
    return 0 if is_good else 1


def measure(folder: Path, kinect: PlayedKinect) -> bool:
    """One line for each fault; whether all are within their limits."""
    print(f"{'fault':20} {'told':>6} {'limit':>6} {'back':>6} {'limit':>6}")
    kinect.unplug()
    with running_service(folder, kinect.environment) as service:
        results = [report("no Kinect at start", plugged_in(kinect, service), TOLD_S, BACK_S)]
        for fault in FAULTS:
            pauses = [partial(time.sleep, last_s) for last_s in LASTING_S]
            slowest = worst([pass_through(fault, kinect, service, pause) for pause in pauses])
            results.append(report_fault(fault, slowest))
        if service.end() != 0:
            raise UserFacingError(f"the service did not end in order: {service.log}")
    return all(results)


def plugged_in(kinect: PlayedKinect, service: PlayedService) -> Passed:
    """A service that was started without a Kinect; it could be heard only from now on."""
    begin_s = time.monotonic()
    told_s = service.until_said(GONE, begin_s)
    time.sleep(LASTING_S[-1])
    end_s = time.monotonic()
    kinect.plug()
    return Passed(told_s - begin_s, service.until_streaming(end_s) - end_s)


def worst(rounds: list[Passed]) -> Passed:
    """The slowest of each."""
    return Passed(max(each.told_s for each in rounds), max(each.back_s for each in rounds))


def report_fault(fault: ServiceFault, passed: Passed) -> bool:
    """See `report`."""
    return report(fault.name, passed, fault.told_s, fault.back_s)


def report(name: str, passed: Passed, told_s: float, back_s: float) -> bool:
    """Print a line; whether it is within the limits."""
    is_good = passed.told_s <= told_s and passed.back_s <= back_s
    print(
        f"{name:20} {passed.told_s:6.2f} {told_s:6.1f} {passed.back_s:6.2f} {back_s:6.1f}"
        f"  {'pass' if is_good else 'FAIL'}",
        flush=True,
    )
    return is_good


if __name__ == "__main__":
    sys.exit(main())

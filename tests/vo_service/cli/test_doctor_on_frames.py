"""`kinect-vo doctor` on the frames of a played Kinect: the right cause for each fault.

A doctor who looks at frames mostly waits, so all cases are examined at once, in processes of their
own, each on a Kinect of its own; the tests look at what was said.
"""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.forked_process import KINECT_VO, ForkedProcess
from tests.simulators.kinect_simulator import KinectModel, KinectSimulator, KinectStream
from tests.simulators.usb_frames import UsbFrames
from tests.vo_service.cli.diagnosis import Diagnosis, failed_checks, find_check
from tests.waiting import DEFAULT_TIMEOUT_S, wait_until

AT_ONCE = 4
QUICK = ("--seconds", "1", "--json")


@dataclass(frozen=True)
class Case:
    """A Kinect with a fault; `later` strikes while the doctor looks at its frames."""

    fault: Callable[[KinectSimulator], None] = lambda kinect: None
    model: KinectModel = KinectModel.K1414
    arguments: tuple[str, ...] = QUICK
    later: Callable[[KinectSimulator], None] = lambda kinect: None


def in_the_middle(fault: Callable[[KinectSimulator], None]) -> Callable[[KinectSimulator], None]:
    """The fault, once a few frames have come."""

    def strike(kinect: KinectSimulator) -> None:
        wait_until(lambda: min(kinect.frames_sent) > 20)
        fault(kinect)

    return strike


def lame(kinect: KinectSimulator) -> None:
    """What a Kinect still works with."""
    kinect.set_firmware_loaded(False)
    kinect.attach_kernel_driver()
    kinect.lose_packets(KinectStream.DEPTH, 3000)


LONG = ("--seconds", "30", "--json")
CASES = {
    "healthy": Case(),
    "hanging": Case(lambda kinect: kinect.freeze_control()),
    "starved": Case(lambda kinect: kinect.remove_bandwidth()),
    "torn": Case(lambda kinect: kinect.lose_packets(KinectStream.DEPTH, 50)),
    "lame": Case(lame, KinectModel.K1473),
    "unplugged": Case(arguments=LONG, later=in_the_middle(lambda kinect: kinect.unplug())),
    "stalled": Case(arguments=LONG, later=in_the_middle(lambda kinect: kinect.stall())),
}


@pytest.fixture(scope="module")
def diagnoses(
    simulated_libusb: Path,
    real_libfreenect: None,
    kinect_frames: UsbFrames,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[dict[str, Future[Diagnosis]]]:
    """What the doctor says of each case, sooner or later."""
    folder = tmp_path_factory.mktemp("kinects")
    with ThreadPoolExecutor(AT_ONCE) as pool:

        def examine(case: Case) -> Diagnosis:
            with KinectSimulator(folder, kinect_frames, case.model) as kinect:
                kinect.waits_for_reader = True
                case.fault(kinect)
                return examined(kinect, case)

        yield {name: pool.submit(examine, case) for name, case in CASES.items()}
        pool.shutdown(cancel_futures=True)


def examined(kinect: KinectSimulator, case: Case) -> Diagnosis:
    """Run the doctor in a process of its own."""
    command = [*KINECT_VO, "doctor", *case.arguments]
    environment = os.environ | kinect.environment
    with ForkedProcess(command, env=environment, stdout=subprocess.PIPE, text=True) as doctor:
        try:
            case.later(kinect)
            output, _ = doctor.communicate(timeout=DEFAULT_TIMEOUT_S)
        finally:
            doctor.kill()
    diagnosis: Diagnosis = json.loads(output)
    assert doctor.returncode == (1 if diagnosis["verdict"] == "fail" else 0)
    return diagnosis


@pytest.mark.subprocess
@pytest.mark.parametrize(
    "name",
    ["libraries", "sensor", "usb-speed", "permission", "sole-use", "first-frames", "gravity"],
)
def test_a_healthy_kinect_passes(diagnoses: dict[str, Future[Diagnosis]], name: str) -> None:
    assert find_check(diagnoses["healthy"].result(), name)["verdict"] == "pass"


@pytest.mark.subprocess
@pytest.mark.parametrize(
    ("case", "check", "cause"),
    [
        ("hanging", "first-frames", "the driver hung while opening the camera"),
        ("starved", "first-frames", "no USB bandwidth"),
        ("torn", "first-frames", "frames were discarded, because packets were lost"),
        ("unplugged", "frame-rate", "the Kinect is gone"),
        ("stalled", "frame-rate", "image for 1 s"),
    ],
)
def test_each_reason_that_prevents_frames_is_reported(
    diagnoses: dict[str, Future[Diagnosis]], case: str, check: str, cause: str
) -> None:
    diagnosis = diagnoses[case].result()
    assert check in failed_checks(diagnosis)
    assert cause in failed_checks(diagnosis)[check]
    assert find_check(diagnosis, check)["fix"]


@pytest.mark.parametrize(
    ("check", "cause"),
    [
        ("kernel-driver", "a kernel driver has the camera"),
        ("firmware", "no audios.bin in"),
        ("gravity", "no reading"),
    ],
)
def test_a_fault_that_does_not_prevent_frames_is_a_warning(
    diagnoses: dict[str, Future[Diagnosis]], check: str, cause: str
) -> None:
    diagnosis = diagnoses["lame"].result()
    found = find_check(diagnosis, check)
    assert found["verdict"] == "warning"
    assert cause in found["text"]
    assert find_check(diagnosis, "first-frames")["verdict"] == "pass"


def test_lost_packets_are_counted_during_the_stream(
    diagnoses: dict[str, Future[Diagnosis]],
) -> None:
    found = find_check(diagnoses["lame"].result(), "lost-packets")
    assert found["verdict"] in ("warning", "fail")
    assert found["facts"]["lost_packets"] > 0

"""`kinect-vo doctor` on a played Kinect: the right cause for each fault, by the real libraries.

A doctor who looks at frames mostly waits, so the cases with frames are all examined at once, in
processes of their own, each on a Kinect of its own; the tests look at what was said.
"""

import json
import os
import subprocess
import tarfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from ctypes.util import find_library
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.tum.folder import open_folder
from tests.stand_ins.played_kinect import Model, PlayedKinect, Stream
from tests.stand_ins.wire_film import WireFilm
from tests.vo_service.commands.command_line import KINECT_VO, call, wait_for

PATIENCE_S = 100.0
NEEDS_OPENNI2 = pytest.mark.skipif(
    find_library("OpenNI2") is None, reason="needs libOpenNI2.so.0: apt install libopenni2-0"
)
AT_ONCE = 4
QUICK = ("--seconds", "1", "--json")
Diagnosis = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A Kinect with a fault; `later` strikes while the doctor looks at its frames."""

    fault: Callable[[PlayedKinect], None] = lambda kinect: None
    model: Model = Model.K1414
    arguments: tuple[str, ...] = QUICK
    later: Callable[[PlayedKinect], None] = lambda kinect: None


def in_the_middle(fault: Callable[[PlayedKinect], None]) -> Callable[[PlayedKinect], None]:
    """The fault, once a few frames have come."""

    def strike(kinect: PlayedKinect) -> None:
        wait_for(lambda: min(kinect.frames_sent) > 20)
        fault(kinect)

    return strike


def lame(kinect: PlayedKinect) -> None:
    """What a Kinect still works with."""
    kinect.firmware(False)
    kinect.kernel_driver()
    kinect.lose_packets(Stream.DEPTH, 3000)


LONG = ("--seconds", "30", "--json")
CASES = {
    "healthy": Case(),
    "hanging": Case(lambda kinect: kinect.freeze_control()),
    "starved": Case(lambda kinect: kinect.starve()),
    "torn": Case(lambda kinect: kinect.lose_packets(Stream.DEPTH, 50)),
    "lame": Case(lame, Model.K1473),
    "unplugged": Case(arguments=LONG, later=in_the_middle(lambda kinect: kinect.unplug())),
    "stalled": Case(arguments=LONG, later=in_the_middle(lambda kinect: kinect.stall())),
}


@pytest.fixture(scope="module")
def diagnoses(
    played_libusb: Path,
    real_libfreenect: None,
    kinect_film: WireFilm,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[dict[str, Future[Diagnosis]]]:
    """What the doctor says of each case, sooner or later."""
    folder = tmp_path_factory.mktemp("kinects")
    with ExitStack() as stack, ThreadPoolExecutor(AT_ONCE) as pool:

        def examine(case: Case) -> Diagnosis:
            with PlayedKinect(folder, kinect_film, case.model) as kinect:
                kinect.patient = True
                case.fault(kinect)
                return examined(kinect, case)

        yield {name: pool.submit(examine, case) for name, case in CASES.items()}
        stack.callback(pool.shutdown, cancel_futures=True)


@pytest.fixture
def kinect(
    play_kinect: Callable[[], PlayedKinect],
    real_libfreenect: None,
    monkeypatch: pytest.MonkeyPatch,
) -> PlayedKinect:
    """A Kinect that the children of this process see."""
    played = play_kinect()
    for name, value in played.environment.items():
        monkeypatch.setenv(name, value)
    return played


def examined(kinect: PlayedKinect, case: Case) -> Diagnosis:
    """Run the doctor as a user does."""
    command = [KINECT_VO, "doctor", *case.arguments]
    environment = os.environ | kinect.environment
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as doctor:
        try:
            case.later(kinect)
            said, _ = doctor.communicate(timeout=PATIENCE_S)
        finally:
            doctor.kill()
    diagnosis: Diagnosis = json.loads(said)
    assert doctor.returncode == (1 if diagnosis["verdict"] == "fail" else 0)
    return diagnosis


def failures(diagnosis: Diagnosis) -> dict[str, str]:
    """Name and text of what has failed."""
    return {
        check["name"]: check["text"] for check in diagnosis["checks"] if check["verdict"] == "fail"
    }


def check_of(diagnosis: Diagnosis, name: str) -> dict[str, Any]:
    """One check's finding."""
    found: dict[str, Any] = next(c for c in diagnosis["checks"] if c["name"] == name)
    return found


@pytest.mark.parametrize(
    "name",
    ["libraries", "sensor", "usb-speed", "permission", "sole-use", "first-frames", "gravity"],
)
def test_a_healthy_kinect_passes(diagnoses: dict[str, Future[Diagnosis]], name: str) -> None:
    assert check_of(diagnoses["healthy"].result(), name)["verdict"] == "pass"


@pytest.mark.parametrize(
    ("fault", "check", "cause"),
    [
        (lambda kinect: kinect.unplug(), "sensor", "no sensor on the USB"),
        (lambda kinect: kinect.forbid(), "permission", "this user may not open it"),
        (lambda kinect: kinect.busy(), "sole-use", "another program has the camera"),
        (lambda kinect: kinect.slow_bus(), "usb-speed", "12 Mbit/s; the sensor needs 480"),
    ],
    ids=["unplugged", "forbidden", "busy", "slow"],
)
def test_what_keeps_the_camera_from_being_opened_is_named(
    fault: Callable[[PlayedKinect], None], check: str, cause: str, kinect: PlayedKinect,
    capfd: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    fault(kinect)
    outcome = call(capfd, "doctor", "--json")
    diagnosis = json.loads(outcome.out)
    assert (outcome.code, list(failures(diagnosis))) == (1, [check])
    assert failures(diagnosis)[check].startswith(cause)
    assert check_of(diagnosis, check)["fix"]
    assert check_of(diagnosis, "first-frames")["verdict"] == "skipped"


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        pytest.param(
            "openni2",
            "Kinect 1414, bus 1 port 1.2, serial A00123456789012A, which is another kind",
            marks=NEEDS_OPENNI2,
        ),
        ("freenect:B1", "none has the serial B1; there is Kinect 1414, bus 1 port 1.2"),
    ],
)
def test_what_is_there_instead_is_named(
    source: str, cause: str, kinect: PlayedKinect, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = call(capfd, "doctor", "--camera", source)
    assert outcome.code == 1
    assert f"✗ sensor         {cause}" in outcome.out
    assert "fix: `kinect-vo devices` lists" in outcome.out


@pytest.mark.parametrize(
    ("case", "check", "cause"),
    [
        ("hanging", "first-frames", "the driver hung while opening the camera"),
        ("starved", "first-frames", "no USB bandwidth"),
        ("torn", "first-frames", "frames lost packets"),
        ("unplugged", "frame-rate", "the Kinect is gone"),
        ("stalled", "frame-rate", "image for 1 s"),
    ],
)
def test_what_keeps_frames_from_coming_is_named(
    diagnoses: dict[str, Future[Diagnosis]], case: str, check: str, cause: str
) -> None:
    diagnosis = diagnoses[case].result()
    assert check in failures(diagnosis)
    assert cause in failures(diagnosis)[check]
    assert check_of(diagnosis, check)["fix"]


@pytest.mark.parametrize(
    ("check", "cause"),
    [
        ("kernel-driver", "a kernel driver has the camera"),
        ("firmware", "no audios.bin in"),
        ("gravity", "no reading"),
    ],
)
def test_what_still_works_is_a_warning(
    diagnoses: dict[str, Future[Diagnosis]], check: str, cause: str
) -> None:
    diagnosis = diagnoses["lame"].result()
    found = check_of(diagnosis, check)
    assert found["verdict"] == "warning"
    assert cause in found["text"]
    assert check_of(diagnosis, "first-frames")["verdict"] == "pass"


def test_lost_packets_are_counted_while_frames_come(
    diagnoses: dict[str, Future[Diagnosis]],
) -> None:
    found = check_of(diagnoses["lame"].result(), "lost-packets")
    assert found["verdict"] in ("warning", "fail")
    assert found["facts"]["lost_packets"] > 0


def test_a_loader_that_finds_no_library_is_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "libfreenect.so.0.5").write_text("not a library")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    outcome = call(capfd, "doctor")
    assert outcome.code == 1
    assert "✗ libraries" in outcome.out
    assert f"{tmp_path}/libfreenect.so.0.5: " in outcome.out
    assert "fix: sudo apt install libusb-1.0-0 libfreenect0.5" in outcome.out


def test_a_recording_is_checked_for_its_frames_alone(
    recording: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = call(capfd, "doctor", "--camera", f"tum:{recording}", "--json")
    diagnosis = json.loads(outcome.out)
    assert (outcome.code, diagnosis["verdict"]) == (0, "pass")
    assert [check["name"] for check in diagnosis["checks"]] == [
        "first-frames", "frame-rate", "lost-packets", "skew", "gravity",
    ]  # fmt: skip


def test_what_the_user_gave_is_exit_code_two(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = call(capfd, "doctor", "--camera", f"tum:{tmp_path / 'nowhere'}")
    assert outcome.code == 2
    assert outcome.err.startswith("kinect-vo: error: ")
    assert call(capfd, "doctor", "--camera", "kinect9").code == 2
    assert call(capfd, "doctor", "--report", tmp_path / "kinect.zip").code == 2


def test_a_report_can_be_replayed(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], config: Path
) -> None:
    file = tmp_path / "kinect.tar.gz"
    source = f"tum:{recording}"
    outcome = call(capfd, "doctor", "--camera", source, "--config", config, "--report", file)
    assert outcome.code == 0
    assert f"{file}: " in outcome.err
    assert "MB, with 12 pictures of what the camera sees" in outcome.err
    with tarfile.open(file) as archive:
        archive.extractall(tmp_path)
    report = tmp_path / "kinect"
    assert {path.name for path in report.iterdir()} >= {
        "doctor.json", "versions.json", "usb.txt", "log.txt", config.name,
    }  # fmt: skip
    assert json.loads((report / "doctor.json").read_text())["camera"] == source
    assert len(open_folder(report / "frames", None).frames.pairs) == 12


def test_a_report_without_pictures_says_so_and_has_the_log(
    kinect: PlayedKinect, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    kinect.starve()
    file = tmp_path / "kinect.tar.gz"
    outcome = call(capfd, "doctor", "--seconds", "1", "--report", file)
    assert outcome.code == 1
    assert "without pictures, as the camera sent none" in outcome.err
    with tarfile.open(file) as archive:
        log = archive.extractfile("kinect/log.txt")
        assert log is not None
        assert "Failed to submit isochronous transfer" in log.read().decode()

"""`kinect-vo doctor` where it opens no camera, and its reports."""

import json
import re
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.tum.folder import open_tum_folder
from tests.simulators.kinect_simulator import KinectSimulator
from tests.vo_service.cli.cli_runner import KinectVo
from tests.vo_service.cli.diagnosis import failed_checks, find_check

pytestmark = pytest.mark.subprocess


@pytest.fixture
def kinect(
    simulate_kinect: Callable[[], KinectSimulator],
    real_libfreenect: None,
    monkeypatch: pytest.MonkeyPatch,
) -> KinectSimulator:
    """A Kinect that the children of this process see."""
    played = simulate_kinect()
    for name, value in played.environment.items():
        monkeypatch.setenv(name, value)
    return played


@pytest.mark.parametrize(
    ("fault", "check", "cause"),
    [
        (lambda kinect: kinect.unplug(), "sensor", "no sensor on the USB"),
        (lambda kinect: kinect.deny_access(), "permission", "this user may not open the sensor"),
        (lambda kinect: kinect.set_busy(), "sole-use", "another program has the camera"),
        (
            lambda kinect: kinect.set_full_speed_bus(),
            "usb-speed",
            "12 Mbit/s; the sensor needs 480",
        ),
    ],
    ids=["unplugged", "forbidden", "busy", "slow"],
)
def test_each_reason_that_prevents_opening_is_reported(
    fault: Callable[[KinectSimulator], None], check: str, cause: str, kinect: KinectSimulator,
    kinect_vo: KinectVo
) -> None:  # fmt: skip
    fault(kinect)
    outcome = kinect_vo("doctor", "--json")
    diagnosis = json.loads(outcome.out)
    assert (outcome.code, list(failed_checks(diagnosis))) == (1, [check])
    assert failed_checks(diagnosis)[check].startswith(cause)
    assert find_check(diagnosis, check)["fix"]
    assert find_check(diagnosis, "first-frames")["verdict"] == "skipped"


def assert_named_instead(source: str, cause: str, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("doctor", "--camera", source)
    assert outcome.code == 1
    assert f"✗ sensor         {cause}" in outcome.out
    assert "fix: `kinect-vo devices` lists" in outcome.out


@pytest.mark.usefixtures("kinect", "real_openni2")
def test_a_sensor_of_another_kind_is_reported(kinect_vo: KinectVo) -> None:
    cause = "Kinect 1414, bus 1 port 1.2, serial A00123456789012A is another kind"
    assert_named_instead("openni2", cause, kinect_vo)


@pytest.mark.usefixtures("kinect")
def test_a_kinect_with_another_serial_is_reported(kinect_vo: KinectVo) -> None:
    cause = "no sensor has the serial B1; connected: Kinect 1414, bus 1 port 1.2"
    assert_named_instead("freenect:B1", cause, kinect_vo)


def test_a_missing_library_is_reported(
    tmp_path: Path, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "libfreenect.so.0.5").write_text("not a library")
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    outcome = kinect_vo("doctor")
    assert outcome.code == 1
    assert "✗ libraries" in outcome.out
    assert f"{tmp_path}/libfreenect.so.0.5: " in outcome.out
    assert "fix: sudo apt install libusb-1.0-0 libfreenect0.5" in outcome.out


def test_only_the_frames_of_a_recording_are_checked(recording: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("doctor", "--camera", f"tum:{recording}", "--json")
    diagnosis = json.loads(outcome.out)
    assert (outcome.code, diagnosis["verdict"]) == (0, "pass")
    assert [check["name"] for check in diagnosis["checks"]] == [
        "first-frames", "plausible", "frame-rate", "lost-packets", "skew", "gravity", "floor",
    ]  # fmt: skip


def test_a_report_can_be_replayed(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo, config: Path
) -> None:
    file = tmp_path / "kinect.tar.gz"
    source = f"tum:{recording}"
    outcome = kinect_vo("doctor", "--camera", source, "--config", config, "--report", file)
    assert outcome.code == 0
    assert f"{file}: " in outcome.err
    # A busy machine drops some of the twelve.
    match = re.search(r"MB, with (\d+) camera images", outcome.err)
    assert match is not None
    with tarfile.open(file) as archive:
        archive.extractall(tmp_path)
    report = tmp_path / "kinect"
    assert {path.name for path in report.iterdir()} >= {
        "doctor.json", "versions.json", "usb.txt", "log.txt", config.name,
    }  # fmt: skip
    assert json.loads((report / "doctor.json").read_text())["camera"] == source
    assert len(open_tum_folder(report / "frames", None).frames.pairs) == int(match[1]) > 0


def test_a_report_without_images_says_so_and_has_the_log(
    kinect: KinectSimulator, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    kinect.remove_bandwidth()
    file = tmp_path / "kinect.tar.gz"
    outcome = kinect_vo("doctor", "--seconds", "1", "--report", file)
    assert outcome.code == 1
    assert "without images, because the camera sent none" in outcome.err
    with tarfile.open(file) as archive:
        log = archive.extractfile("kinect/log.txt")
        assert log is not None
        assert "Failed to submit isochronous transfer" in log.read().decode()

"""The command that runs other commands on a simulated Kinect."""

import subprocess
import sys
from pathlib import Path

import pytest

from drivers.core import InputError
from tests.simulators.fault_script import (
    FAULT_NAMES,
    TimedFault,
    parse_fault,
    run_command,
    schedule_faults,
)
from tests.simulators.fixtures import SimulateKinect, pattern_frame
from tests.simulators.frame_sources import folder_frames
from tests.simulators.kinect_simulator import KinectSimulator
from tests.simulators.run_with_kinect import main

pytestmark = pytest.mark.usefixtures("real_libfreenect")
ROOT = Path(__file__).parents[2]
PROBE = (sys.executable, "-m", "tests.simulators.freenect_probe", "0.6")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A TUM folder of two frames, 640x480."""
    import cv2

    folder = tmp_path / "recording"
    for part in ("rgb", "depth"):
        (folder / part).mkdir(parents=True)
    for seq in range(2):
        bgr, depth_mm = pattern_frame(seq)
        cv2.imwrite(str(folder / f"rgb/{seq}.png"), bgr)
        cv2.imwrite(str(folder / f"depth/{seq}.png"), depth_mm * 5)
    lines = "".join(f"{seq}.0 rgb/{seq}.png {seq}.0 depth/{seq}.png\n" for seq in range(2))
    (folder / "associations.txt").write_text(lines)
    (folder / "camera.toml").write_text(
        "schema = 1\nwidth = 640\nheight = 480\nfx = 525.0\nfy = 525.0\ncx = 319.5\ncy = 239.5\n"
        "distortion = [0.0, 0.0, 0.0, 0.0, 0.0]\ndepth_factor = 5000.0\n"
    )
    return folder


def run_with_kinect(*arguments: str, stdin: str = "") -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, "-m", "tests.simulators.run_with_kinect", *arguments]
    return subprocess.run(
        command, cwd=ROOT, input=stdin, capture_output=True, text=True, timeout=100, check=False
    )


@pytest.mark.subprocess
def test_a_command_sees_a_kinect_that_plays_a_folder(folder: Path) -> None:
    result = run_with_kinect("--folder", str(folder), "--patient", "--", *PROBE, stdin="jump\n")
    assert result.returncode == 0, result.stderr
    assert "'jump': type one of: plug" in result.stderr
    opened, frames = result.stdout.splitlines()
    assert opened == "opened 0"
    assert min(map(int, frames.split()[1:])) > 0


@pytest.mark.subprocess
def test_faults_happen_at_their_time(folder: Path) -> None:
    result = run_with_kinect("--folder", str(folder), "--fault", "busy", "--", *PROBE)
    assert result.stdout.startswith("opened -")


@pytest.mark.subprocess
def test_the_exit_code_is_the_commands_own(folder: Path) -> None:
    code = "import os, signal; os.kill(os.getpid(), signal.SIGKILL)"
    assert (
        run_with_kinect("--folder", str(folder), "--", sys.executable, "-c", code).returncode == 137
    )


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "no command to run"),
        (["--fault", "explode", "--", "true"], "fault 'explode': use NAME@START"),
        (["--folder", "/nowhere", "--", "true"], "/nowhere: no such folder"),
    ],
)
def test_an_error_is_one_line(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("run_with_kinect: error: ")
    assert says in line


def test_depth_of_a_folder_becomes_millimeters(folder: Path) -> None:
    for seq, (bgr, depth_mm) in enumerate(folder_frames(folder)):
        assert (bgr == pattern_frame(seq)[0]).all()
        assert (depth_mm == pattern_frame(seq)[1]).all()


def test_a_fault_has_a_name_a_number_and_times() -> None:
    assert parse_fault("unplug@5s+3s") == TimedFault("unplug", 100, 5.0, 3.0)
    assert parse_fault("lose=50@2.5") == TimedFault("lose", 50, 2.5, None)
    assert parse_fault("no-firmware") == TimedFault("no-firmware", 100, 0.0, None)


@pytest.mark.parametrize("text", ["", "unplug@", "unplug@x", "lose=@1", "stall@1 +2"])
def test_an_invalid_fault_is_rejected(text: str) -> None:
    with pytest.raises(InputError):
        parse_fault(text)


@pytest.mark.parametrize("name", FAULT_NAMES)
def test_every_fault_can_be_switched_on_and_off(simulate_kinect: SimulateKinect, name: str) -> None:
    kinect: KinectSimulator = simulate_kinect()
    fresh = switches(kinect)
    run_command(kinect, f"{name}\n")
    assert switches(kinect) != fresh
    run_command(kinect, f"{name} off\n")
    assert switches(kinect) == fresh


def switches(kinect: KinectSimulator) -> tuple[int, ...]:
    control = kinect._control
    names = ("plugged", "frozen", "busy", "forbidden", "starved", "slow_bus", "firmware")
    streams = [(stream.stalled, stream.lose_every) for stream in control.streams]
    return (*(getattr(control, name) for name in names), control.kernel_driver, *sum(streams, ()))


def test_scheduled_faults_come_and_go(simulate_kinect: SimulateKinect) -> None:
    kinect = simulate_kinect()
    before = switches(kinect)
    timers = schedule_faults(kinect, [parse_fault("busy+0.05"), parse_fault("unplug@0.02+0.02")])
    assert switches(kinect) != before
    for timer in timers:
        timer.join(timeout=100)
    assert switches(kinect) == before


def test_an_invalid_line_is_rejected(simulate_kinect: SimulateKinect) -> None:
    with pytest.raises(InputError, match="type one of: plug"):
        run_command(simulate_kinect(), "jump\n")


def test_ctrl_c_while_the_frames_are_written_prints_no_traceback(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("tests.simulators.run_with_kinect.write_fitted_usb_frames", interrupt)
    assert main(["--folder", str(folder), "--", "true"]) == 130

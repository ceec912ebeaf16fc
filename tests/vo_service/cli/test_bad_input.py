"""Whatever a user gets wrong is one clear line and a code that is not 0."""

import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.core import InputError
from tests.vo_service.cli.cli_runner import CommandResult, run_in_process, run_subprocess
from vo_service.outputs.zenoh import free_port

CopyRecording = Callable[..., Path]


def assert_one_line(outcome: CommandResult, code: int, message: str) -> None:
    *notes, error = outcome.err.splitlines()
    assert (outcome.code, outcome.out) == (code, "")
    assert all("preparing the numeric kernels" in note for note in notes)  # on a slow machine
    assert error.startswith("kinect-vo: error: ")
    assert message in error


def edit(file: Path, change: Callable[[list[str]], list[str]]) -> None:
    file.write_text("\n".join(change(file.read_text().splitlines())) + "\n")


def replace_line(name: str, number: int, line: str) -> Callable[[Path], None]:
    """Put something else on a line, counted from 1."""

    def change(lines: list[str]) -> list[str]:
        return [*lines[: number - 1], line, *lines[number:]]

    return lambda folder: edit(folder / name, change)


def replace_text(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return change


def empty(folder: Path) -> None:
    shutil.rmtree(folder)
    folder.mkdir()


def first(folder: Path, kind: str) -> Path:
    return folder / kind / "0.000000.png"


def truncate(folder: Path) -> None:
    data = first(folder, "rgb").read_bytes()
    first(folder, "rgb").write_bytes(data[: len(data) // 2])


def make_pipe(folder: Path) -> None:
    first(folder, "rgb").unlink()
    os.mkfifo(first(folder, "rgb"))


def write_image(folder: Path, kind: str, shape: tuple[int, ...], dtype: type) -> None:
    assert cv2.imwrite(str(first(folder, kind)), np.ones(shape, dtype))


def unmatch(folder: Path) -> None:
    edit(folder / "depth.txt", lambda lines: [f"5{line}" for line in lines if line[0] != "#"])


def swap_truth(folder: Path) -> None:
    edit(folder / "groundtruth.txt", lambda lines: [lines[0], *reversed(lines[1:])])


BROKEN: dict[str, tuple[Callable[[Path], object], str]] = {
    "no folder": (shutil.rmtree, "corner: no such folder"),
    "empty folder": (empty, "corner: the folder is empty"),
    "no color list": (lambda f: (f / "rgb.txt").unlink(), "rgb.txt: no such file"),
    "no depth list": (lambda f: (f / "depth.txt").unlink(), "depth.txt: no such file"),
    "empty list": (lambda f: (f / "rgb.txt").write_text("# nothing\n"), "rgb.txt: names no image"),
    "three columns": (replace_line("rgb.txt", 4, "0.1 rgb/a b.png"), "rgb.txt:4: 3 columns"),
    "not a stamp": (replace_line("rgb.txt", 4, "soon rgb/a.png"), 'rgb.txt:4: "soon" is not'),
    "stamp repeats": (replace_line("depth.txt", 3, "0 depth/a.png"), "depth.txt:3: stamp 0 repe"),
    "stamp goes back": (replace_line("rgb.txt", 5, "0.01 rgb/a.png"), "rgb.txt:5: stamp 0.01 goes"),
    "first missing": (lambda f: first(f, "rgb").unlink(), "rgb/0.000000.png, which is missing"),
    "first truncated": (truncate, "rgb/0.000000.png: is truncated"),
    "first no image": (lambda f: first(f, "depth").write_text("hi"), "000000.png: is not an image"),
    "first empty": (lambda f: first(f, "rgb").write_text(""), "0.000000.png: is empty (0 bytes)"),
    "first a pipe": (make_pipe, "rgb/0.000000.png: cannot be read: it is a pipe, not a file"),
    "Latin-1 list": (
        lambda f: (f / "rgb.txt").write_bytes(b"# k\xfcche\n0 rgb/a.png\n"),
        "rgb.txt:1: is not UTF-8 text (invalid start byte); give a text file with lines of: stamp",
    ),
    "8-bit depth": (
        lambda f: write_image(f, "depth", (240, 320), np.uint8),
        "depth/0.000000.png: depth has 8 bits and 1 channel(s), where 16 bits",
    ),
    "sizes differ": (
        lambda f: write_image(f, "depth", (120, 320), np.uint16),
        "color is 320x240 but depth",
    ),
    "another camera": (
        replace_text("camera.toml", "width = 320", "width = 640"),
        "the image is 320x240 but the camera is 640x240",
    ),
    "no pairs in range": (unmatch, "no color and depth images within 20 ms of each other"),
    "no camera": (lambda f: (f / "camera.toml").unlink(), "no camera file, and the folder"),
    "camera typo": (
        replace_text("camera.toml", "fx = ", "f_x = "),
        "camera.toml:4: key `f_x`: is unknown; did you mean `fx`?",
    ),
    "depth factor 0": (
        replace_text("camera.toml", "depth_factor = 5000.0", "depth_factor = 0"),
        "camera.toml:9: key `depth_factor`: 0 is out of range",
    ),
    "NaN in the truth": (
        replace_line("groundtruth.txt", 4, "0.066667 nan 0 0 0 0 0 1"),
        "groundtruth.txt:4: a value is not finite",
    ),
    "unsorted truth": (
        swap_truth,
        "groundtruth.txt:3: stamp 0.333333 is not after the previous one",
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_an_invalid_folder_is_reported_and_an_existing_trajectory_is_kept(
    fault: str, copy_recording: CopyRecording, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, (break_it, message) = copy_recording(lists=True), BROKEN[fault]
    break_it(folder)
    kept = tmp_path / "poses.txt"
    kept.write_text("precious\n")
    outcome = run_in_process(
        capfd, "replay", folder, "--no-publish", "--json", "--trajectory", kept
    )
    assert_one_line(outcome, InputError.exit_code, message)
    assert kept.read_text() == "precious\n"


def test_a_pipe_among_the_images_is_skipped_and_blocks_nothing(
    copy_recording: CopyRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = copy_recording(lists=True)
    image = sorted((folder / "rgb").iterdir())[5]
    image.unlink()
    os.mkfifo(image)
    outcome = run_in_process(capfd, "replay", folder, "--no-publish")
    assert outcome.code == 0
    assert f"{image}: cannot be read: it is a pipe, not a file" in outcome.err


# Each names the pipe PIPE, PIPE.mcap or PIPE.oni, where the command expects a file; REC is a
# recording.
PIPES = (
    "replay PIPE.mcap",
    "replay REC --config PIPE",
    "replay REC --camera-file PIPE",
    "convert PIPE.bag out",
    "record --camera bag:PIPE.mcap out",
    "record --camera openni2:PIPE.oni out",
    "evaluate PIPE REC",
    "evaluate REC/groundtruth.txt PIPE",
    "reconstruct REC PIPE",
    "config check PIPE",
    "listen --config-file PIPE",
    "router PIPE",
    "compare REC --orb-vocabulary PIPE --methods orb-slam3",
)


@pytest.mark.zenoh
@pytest.mark.parametrize("command", PIPES)
def test_a_pipe_for_a_file_is_refused_and_not_waited_for(
    command: str,
    copy_recording: CopyRecording,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for suffix in ("", ".mcap", ".bag", ".oni"):
        os.mkfifo(tmp_path / f"PIPE{suffix}")
    copy_recording(name="REC")
    monkeypatch.chdir(tmp_path)
    outcome = run_in_process(capfd, *command.split())
    assert_one_line(outcome, InputError.exit_code, "it is a pipe, not a file; ")


@pytest.mark.parametrize("list_name", ["rgb.txt", "depth.txt", "groundtruth.txt", "camera.toml"])
def test_a_list_in_utf16_is_read(
    list_name: str, copy_recording: CopyRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = copy_recording(lists=True)
    (folder / list_name).write_text((folder / list_name).read_text(), "utf-16")
    assert run_in_process(capfd, "replay", folder, "--no-publish").code == 0


@pytest.mark.parametrize("name", ["x.mp4", "y.db3"])
def test_a_recording_is_not_made_under_the_name_of_another_file(
    name: str, recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    for command in (("record", "--camera", f"tum:{recording}"), ("convert", recording)):
        outcome = run_in_process(capfd, *command, tmp_path / name)
        assert (outcome.code, len(outcome.err.splitlines())) == (InputError.exit_code, 1)
        assert f"{name}: " in outcome.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.subprocess
def test_python_m_vo_service_is_the_command() -> None:
    program = [sys.executable, "-m", "vo_service", "replai"]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ended.returncode == InputError.exit_code
    assert "invalid choice: 'replai'" in ended.stderr


@pytest.mark.subprocess
@pytest.mark.parametrize("fault", ["no folder", "depth factor 0"])
def test_a_service_reports_the_same_error_and_exits(
    fault: str, copy_recording: CopyRecording, capfd: pytest.CaptureFixture[str]
) -> None:
    folder, (break_it, message) = copy_recording(lists=True), BROKEN[fault]
    break_it(folder)
    outcome = run_in_process(capfd, "run", "--camera", f"tum:{folder}", "--no-publish")
    assert_one_line(outcome, InputError.exit_code, message)


@pytest.mark.subprocess
def test_a_new_process_shows_no_traceback_either(tmp_path: Path) -> None:
    assert_one_line(
        run_subprocess("replay", tmp_path / "none", "--no-publish"), 2, "none: no such folder"
    )


@pytest.mark.parametrize("where", ["none/poses.txt", "."])
def test_an_unwritable_trajectory_is_an_error(
    where: str, recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = run_in_process(
        capfd, "replay", recording, "--no-publish", "--trajectory", tmp_path / where
    )
    assert_one_line(outcome, 2, "cannot be written: ")


@pytest.mark.zenoh
def test_a_port_in_use_is_reported_and_the_trajectory_kept(
    recording: Path, config: Path, port: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    kept = tmp_path / "poses.txt"
    kept.write_text("precious\n")
    with socket.create_server(("127.0.0.1", port)):
        outcome = run_in_process(
            capfd, "replay", recording, "--config", config, "--trajectory", kept
        )
    assert_one_line(outcome, 1, f"zenoh cannot listen on tcp/127.0.0.1:{port}: the port is in use")
    assert kept.read_text() == "precious\n"


@pytest.mark.zenoh
def test_with_a_subscriber_to_wait_for_the_default_port_is_required(
    recording: Path,
    config: Path,
    port: int,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(free_port, "DEFAULT_ENDPOINT", f"tcp/127.0.0.1:{port}")
    options = ("--config", config, "--wait-for-subscriber", "1")
    with socket.create_server(("127.0.0.1", port)):
        outcome = run_in_process(capfd, "replay", recording, *options)
    assert_one_line(outcome, 1, f"zenoh cannot listen on tcp/127.0.0.1:{port}: the port is in use")


@pytest.mark.subprocess
def test_an_unwritable_rerun_recording_is_an_error_with_its_cause(
    recording: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    outcome = run_in_process(capfd, "replay", recording, "--no-publish", "--rerun", "/proc/a.rrd")
    assert_one_line(outcome, 1, "/proc/a.rrd: cannot be written: No such file or directory")


ARGUMENTS = {
    "method": (["replay", "X", "--method", "orb"], "--method: invalid choice: 'orb'"),
    "profile": (["run", "--profile", "tiny"], "--profile: invalid choice: 'tiny' (choose from"),
    "pace": (
        ["replay", "X", "--pace", "fast"],
        "--pace: fast is not a pace: give lockstep or realtime",
    ),
    "wait": (["replay", "X", "--wait-for-subscriber", "-1"], "-1 is not a duration"),
    "wait for what": (
        ["replay", "X", "--wait-for-subscriber", "x"],
        "x is not a duration: give sec",
    ),
    "count": (["listen", "--count", "many"], "many is not a number of poses: give 1 or more"),
    "no folder": (["replay"], "required: RECORDING; see `kinect-vo replay --help`"),
    "option": (["replay", "X", "--trajectry", "Y"], "unrecognized arguments: --trajectry Y"),
    "command": (["replai"], "invalid choice: 'replai'"),
    "no command": ([], "required: COMMAND"),
    "no command to send": (["command"], "required: NAME; see `kinect-vo command --help`"),
    "no name": (["command", ""], "'' is not a command name"),
    "name with a hash": (["command", "reset#"], "'reset#' is not a command name"),
    "name with a dollar": (["command", "reset$"], "'reset$' is not a command name"),
    "camera": (["run", "--camera", "kinekt"], "camera 'kinekt' is unknown; use one of: freenect"),
    "camera folder": (["run", "--camera", "tum:"], "camera 'tum' needs a folder: tum:FOLDER"),
    "recorded camera": (["record", "--camera", "kinekt", "X"], "camera 'kinekt' is unknown"),
    "seconds": (
        ["record", "--seconds", "nan", "X"],
        "nan is not a duration: give seconds, more than",
    ),
    "endpoint": (["listen", "--connect", "nowhere"], "PROTOCOL/ADDRESS:PORT"),
    "configuration": (["replay", "X", "--config", "none.toml"], "none.toml: cannot be read"),
    "configuration to check": (["config", "check", "none.toml"], "none.toml: cannot be read"),
}


@pytest.mark.zenoh
@pytest.mark.parametrize("mistake", ARGUMENTS)
def test_a_command_line_error_is_one_line(mistake: str, capfd: pytest.CaptureFixture[str]) -> None:
    arguments, message = ARGUMENTS[mistake]
    assert_one_line(run_in_process(capfd, *arguments), 2, message)


@pytest.mark.parametrize(
    ("command", "line", "message"),
    [
        (["config", "check"], "[zenoh]\nlisen = []", ":3: key `zenoh.lisen`: is unknown; did you"),
        (
            ["run", "--config"],
            "[camera]\nsource = 'kinekt'",
            ":3: key `camera.source`: camera 'kinekt'",
        ),
        (["warm-up", "--config"], "[odometry]\nmethod = 'o'", ":3: key `odometry.method`: 'o' is"),
    ],
)
def test_a_typo_in_the_configuration_is_reported_with_its_line(
    command: list[str], line: str, message: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "kinect.toml"
    file.write_text(f"schema = 1\n{line}\n")
    assert_one_line(run_in_process(capfd, *command, file), 2, f"{file}{message}")


def test_a_recording_into_a_folder_that_is_not_empty_is_rejected(
    recording: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").touch()
    outcome = run_in_process(capfd, "record", "--camera", f"tum:{recording}", tmp_path / "full")
    assert_one_line(outcome, 2, "full: is not empty")
    assert [each.name for each in (tmp_path / "full").iterdir()] == ["precious"]

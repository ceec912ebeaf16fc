"""Whatever a user gets wrong is one clear line and a code that is not 0."""

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.core import InputError
from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line
from vo_service.outputs.zenoh import free_port

CopyRecording = Callable[..., Path]


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
    kinect_vo: KinectVo,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for suffix in ("", ".mcap", ".bag", ".oni"):
        os.mkfifo(tmp_path / f"PIPE{suffix}")
    copy_recording(name="REC")
    monkeypatch.chdir(tmp_path)
    outcome = kinect_vo(*command.split())
    assert_one_line(outcome, InputError.exit_code, "it is a pipe, not a file; ")


@pytest.mark.subprocess
def test_python_m_vo_service_is_the_command() -> None:
    program = [sys.executable, "-m", "vo_service", "replai"]
    ended = subprocess.run(program, capture_output=True, text=True, check=False)
    assert ended.returncode == InputError.exit_code
    assert "invalid choice: 'replai'" in ended.stderr


@pytest.mark.subprocess
def test_a_service_reports_the_same_error_and_exits(tmp_path: Path, kinect_vo: KinectVo) -> None:
    outcome = kinect_vo("run", "--camera", f"tum:{tmp_path / 'none'}", "--no-publish")
    assert_one_line(outcome, InputError.exit_code, "none: no such folder")


@pytest.mark.zenoh
def test_a_port_in_use_is_reported_and_the_trajectory_kept(
    recording: Path, config: Path, port: int, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    kept = tmp_path / "poses.txt"
    kept.write_text("precious\n")
    with socket.create_server(("127.0.0.1", port)):
        outcome = kinect_vo("replay", recording, "--config", config, "--trajectory", kept)
    assert_one_line(outcome, 1, f"zenoh cannot listen on tcp/127.0.0.1:{port}: the port is in use")
    assert kept.read_text() == "precious\n"


@pytest.mark.zenoh
def test_with_a_subscriber_to_wait_for_the_default_port_is_required(
    recording: Path, config: Path, port: int, kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(free_port, "DEFAULT_ENDPOINT", f"tcp/127.0.0.1:{port}")
    options = ("--config", config, "--wait-for-subscriber", "1")
    with socket.create_server(("127.0.0.1", port)):
        outcome = kinect_vo("replay", recording, *options)
    assert_one_line(outcome, 1, f"zenoh cannot listen on tcp/127.0.0.1:{port}: the port is in use")


@pytest.mark.subprocess
def test_an_unwritable_rerun_recording_is_an_error_with_its_cause(
    recording: Path, kinect_vo: KinectVo
) -> None:
    outcome = kinect_vo("replay", recording, "--no-publish", "--rerun", "/proc/a.rrd")
    assert_one_line(outcome, 1, "/proc/a.rrd: cannot be written: No such file or directory")


def test_a_recording_into_a_folder_that_is_not_empty_is_rejected(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "precious").touch()
    outcome = kinect_vo("record", "--camera", f"tum:{recording}", tmp_path / "full")
    assert_one_line(outcome, 2, "full: is not empty")
    assert [each.name for each in (tmp_path / "full").iterdir()] == ["precious"]

"""``run`` as a service: ended by signals, published poses, and what the log says."""

import json
import signal
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import FRAMES
from tests.ports import is_listening
from tests.vo_service.cli.cli_runner import (
    CommandResult,
    KinectVo,
    count_lines,
    run_subprocess,
    running_subprocess,
    stretch_timing,
)
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

CopyRecording = Callable[..., Path]


def test_a_service_in_lockstep_writes_the_trajectory_of_a_replay(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    served, replayed = tmp_path / "run.txt", tmp_path / "replay.txt"
    kinect_vo("replay", recording, "--no-publish", "--trajectory", replayed)
    options = ("--pace", "lockstep", "--no-publish", "--trajectory", served)
    with running_subprocess("run", "--camera", f"tum:{recording}", *options) as process:
        wait_until(lambda: count_lines(served) == FRAMES)
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate(timeout=100)
    outcome = CommandResult(process.returncode, out, err)
    assert (outcome.code, outcome.out) == (0, "")
    assert outcome.error_lines in (
        "",
        "kinect-vo: warning: no_camera: the recording has ended; Ctrl-C ends the service\n",
    )
    assert served.read_bytes() == replayed.read_bytes()


def test_listen_prints_what_a_service_publishes(
    copy_recording: CopyRecording, config: Path, port: int
) -> None:
    source = f"tum:{stretch_timing(copy_recording(lists=True), 0.5)}"
    with config.open("a") as file:
        file.write('\n[ros2]\nodom_frame_id = "robot1/odom"\n')
    with running_subprocess("run", "--camera", source, "--config", config) as service:
        wait_until(lambda: is_listening(port))
        outcome = run_subprocess(
            "listen", "--connect", f"tcp/127.0.0.1:{port}", "--count", "3", "--json"
        )
        service.send_signal(signal.SIGTERM)
        assert service.wait(100) == 0
    first_line = f"listen: listening to kinect at tcp/127.0.0.1:{port}\n"
    assert (outcome.code, outcome.err) == (0, first_line)
    messages = [json.loads(line) for line in outcome.out.splitlines()]
    poses = [each for each in messages if each["kind"] == "pose"]
    assert len(poses) == 3
    assert [pose["state"] for pose in poses] == ["tracking"] * 3
    assert [pose["frame_id"] for pose in poses] == ["robot1/odom"] * 3


def test_a_closed_terminal_ends_the_service_and_an_older_trajectory_is_kept(
    recording: Path, tmp_path: Path
) -> None:
    trajectory = tmp_path / "poses.txt"
    trajectory.write_text("precious")
    options = ("--pace", "lockstep", "--no-publish", "--trajectory", trajectory)
    with running_subprocess("run", "--camera", f"tum:{recording}", *options) as process:
        wait_until(lambda: count_lines(trajectory) == FRAMES)
        process.send_signal(signal.SIGHUP)
        assert process.wait(100) == 0
    assert (tmp_path / "poses-0001.txt").read_text() == "precious"


def test_two_outputs_to_one_file_are_refused_before_it_is_renamed(
    recording: Path, tmp_path: Path, kinect_vo: KinectVo
) -> None:
    file = tmp_path / "poses.txt"
    file.write_text("precious")
    options = ("--no-publish", "--trajectory", file, "--mcap", file)
    outcome = kinect_vo("run", "--camera", f"tum:{recording}", *options)
    message = f"kinect-vo: error: {file}: two outputs would be written to it; name another file\n"
    assert (outcome.code, outcome.error_lines) == (2, message)
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [
        ("poses.txt", "precious")
    ]

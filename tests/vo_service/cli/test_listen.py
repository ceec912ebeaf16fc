"""``listen`` in a process of its own against real publishers."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from tests.vo_service.cli.cli_runner import running_subprocess
from tests.vo_service.client.fake_service import (
    FakeService,
    find_free_endpoint,
    running_fake_service,
)

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]


@pytest.fixture
def endpoint() -> str:
    return find_free_endpoint()


@pytest.fixture
def robot(endpoint: str) -> Iterator[FakeService]:
    with running_fake_service(endpoint) as running:
        yield running


def listener(endpoint: str, *options: str) -> AbstractContextManager[subprocess.Popen[str]]:
    """Run the command; it is killed at the end of the block."""
    return running_subprocess("listen", "--connect", endpoint, *options)


def read_line(process: subprocess.Popen[str]) -> str:
    """The next line on stderr."""
    assert process.stderr is not None
    return process.stderr.readline()


def printed(process: subprocess.Popen[str]) -> str:
    """The next line on stdout."""
    assert process.stdout is not None
    return process.stdout.readline()


def read_first_line(process: subprocess.Popen[str], robot: FakeService) -> str:
    """The first line on stderr, once the listener's subscriptions have reached the service."""
    line = read_line(process)
    robot.wait_for_reader()
    return line


def test_a_pose_is_one_line(robot: FakeService) -> None:
    with listener(robot.endpoint, "--count", "2") as process:
        first_line = read_first_line(process, robot)
        assert first_line == f"listen: listening to kinect at {robot.endpoint}\n"
        robot.publish_pose(7, 1.0, epoch=2)
        robot.publish_pose(8, 2.0)
        assert printed(process) == (
            "12.500000 1.0000 0.5000 -0.2500 0.00000 0.00000 0.00000 1.00000 tracking\n"
        )
        assert printed(process).split()[1] == "2.0000"
        assert process.wait(100) == 0


def test_json_is_one_object_per_line(endpoint: str) -> None:
    with (
        running_fake_service(endpoint) as robot,
        listener(endpoint, "--json", "--count", "1") as process,
    ):
        read_first_line(process, robot)
        robot.publish_status(state="degraded", latency={"fps": 30.0})
        status = json.loads(printed(process))
        robot.publish_pose(7, 1.0, epoch=2)
        pose = json.loads(printed(process))
    assert (status["kind"], status["state"]) == ("status", "degraded")
    assert status["latency"]["fps"] == 30.0
    assert (pose["kind"], pose["seq"], pose["epoch"]) == ("pose", 7, 2)
    assert pose["position_m"] == [1.0, 0.5, -0.25]
    assert pose["quaternion_xyzw"] == [0.0, 0.0, 0.0, 1.0]


def test_only_changes_of_status_are_printed(robot: FakeService) -> None:
    with listener(robot.endpoint) as process:
        read_first_line(process, robot)
        for _ in range(2):
            robot.publish_status(state="lost", reason="too few matches")
        robot.publish_status(state="tracking")
        assert read_line(process) == "listen: status lost: too few matches\n"
        assert read_line(process) == "listen: status tracking\n"


def test_a_correction_of_the_map_is_printed_once(robot: FakeService) -> None:
    with listener(robot.endpoint) as process:
        read_first_line(process, robot)
        robot.publish_map_odom(0.25, loop_closures=0)
        for seq in range(3):
            robot.publish_map_odom(0.25, seq=seq)
        robot.publish_map_odom(0.25, seq=4, map_keyframes=10)
        robot.publish_map_odom(0.25, seq=5, is_localized=False)
        assert read_line(process) == (
            "listen: map: 3 keyframes, 1 loop closures; odom at 0.0000 0.2500 0.0000 "
            "0.00000 0.00000 0.00000 1.00000\n"
        )
        assert read_line(process) == (
            "listen: map: 3 keyframes; its transform to odom is unknown\n"
        )


def test_json_has_each_change_of_the_map(robot: FakeService) -> None:
    with listener(robot.endpoint, "--json") as process:
        read_first_line(process, robot)
        for seq, places in ((0, 9), (1, 9), (2, 10)):
            robot.publish_map_odom(0.25, seq=seq, map_keyframes=places)
        found = [json.loads(printed(process)) for _ in range(2)]
    assert [(each["kind"], each["seq"], each["map_keyframes"]) for each in found] == [
        ("map_odom", 0, 9), ("map_odom", 2, 10),
    ]  # fmt: skip
    assert found[0]["position_m"] == [0.0, 0.25, 0.0]
    assert (found[0]["frame_id"], found[0]["child_frame_id"]) == ("map", "odom")


def test_it_waits_for_a_publisher_and_reconnects(endpoint: str) -> None:
    with listener(endpoint, "--count", "2") as process:
        assert read_line(process) == f"listen: waiting for kinect at {endpoint} (Ctrl-C ends)\n"
        with running_fake_service(endpoint) as robot:
            assert "listening to" in read_first_line(process, robot)
            robot.publish_pose(7, 1.0, epoch=2)
            assert printed(process).endswith("tracking\n")
        assert "disconnected" in read_line(process)
        with running_fake_service(endpoint) as robot:
            assert "listening to" in read_first_line(process, robot)
            robot.publish_pose(7, 1.0, epoch=2)
            assert printed(process).endswith("tracking\n")
        assert process.wait(100) == 0


def test_ctrl_c_ends_it_cleanly(endpoint: str) -> None:
    with listener(endpoint) as process:
        assert "waiting" in read_line(process)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=100)
    assert (output, errors, process.returncode) == ("", "", 0)


def test_sigint_ends_it_where_a_shell_has_let_it_be_ignored(endpoint: str) -> None:
    script = "kinect-vo listen --connect $0 & read line; kill -INT $!; wait $!"
    arguments = ["bash", "-c", script, endpoint]
    pipes: dict[str, Any] = dict.fromkeys(("stdin", "stderr"), subprocess.PIPE)
    path = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    with subprocess.Popen(arguments, text=True, env=path, **pipes) as shell:
        assert "waiting" in read_line(shell)
        assert shell.communicate("go\n", timeout=100) == (None, "")
    assert shell.returncode == 0


def test_a_closed_reader_ends_it_quietly(robot: FakeService) -> None:
    with listener(robot.endpoint) as process:
        read_first_line(process, robot)
        assert process.stdout is not None
        process.stdout.close()
        robot.publish_pose(7, 1.0, epoch=2)
        assert process.wait(100) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""

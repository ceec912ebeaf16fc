"""``listen`` in a process of its own against real publishers."""

import json
import os
import signal
import subprocess
import sys
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core.geometry import rigid_transform
from drivers.ros_messages.navigation import (
    OdometryMessage,
    TransformMessage,
    encode_odometry,
    encode_transform,
)
from tests.ports import free_port
from tests.vo_service.cli.cli_runner import running_subprocess
from tests.vo_service.client.fake_service import BLOCK
from tests.waiting import wait_until
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

pytestmark = [pytest.mark.subprocess, pytest.mark.zenoh]

ABOUT = {"schema": 1, "seq": 7, "state": "tracking", "epoch": 2, "reason": ""}


@pytest.fixture
def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


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


class Publisher:
    """What a kinect-vo sends, by hand."""

    def __init__(self, endpoint: str) -> None:
        self._session = open_session(ZenohConfig(listen=(endpoint,)))
        self._odom = self._session.declare_publisher("kinect/odom", congestion_control=BLOCK)
        self._token = self._session.liveliness().declare_token("kinect/alive")

    def put(self, key: str, payload: bytes, about: dict[str, Any] | None = None) -> None:
        """Send a message once the listener's subscriptions have reached us."""
        wait_until(lambda: self._odom.matching_status.matching)  # type: ignore[attr-defined]
        attachment = None if about is None else json.dumps(about).encode()
        self._session.put(f"kinect/{key}", payload, attachment=attachment, congestion_control=BLOCK)

    def pose(self, x_m: float) -> None:
        T = rigid_transform(np.eye(3), [x_m, 0.5, -0.25])
        message = OdometryMessage(12.5, "odom", "base_link", T, np.eye(6), np.zeros(6), np.eye(6))
        self.put("odom", encode_odometry(message), ABOUT)

    def map_odom(self, seq: int, **about: Any) -> None:
        T = rigid_transform(np.eye(3), [0.5, 0.25, 0.0])
        usual = {
            "schema": 1, "seq": seq, "epoch": 0, "is_localized": True,
            "map_keyframes": 9, "loop_closures": 1,
        }  # fmt: skip
        message = TransformMessage(12.5, "map", "odom", T)
        self.put("map_odom", encode_transform(message), usual | about)

    def status(self, state: str, reason: str) -> None:
        content = {"schema": 1, "state": state, "reason": reason, "latency": {"fps": 30.0}}
        self.put("status", json.dumps(content).encode())

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]


def publisher(endpoint: str) -> AbstractContextManager[Publisher]:
    return closing(Publisher(endpoint))


def test_a_pose_is_one_line(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint, "--count", "2") as process:
        assert read_line(process) == f"listen: listening to kinect at {endpoint}\n"
        robot.pose(1.0)
        robot.pose(2.0)
        assert printed(process) == (
            "12.500000 1.0000 0.5000 -0.2500 0.00000 0.00000 0.00000 1.00000 tracking\n"
        )
        assert printed(process).split()[1] == "2.0000"
        assert process.wait(100) == 0


def test_json_is_one_object_per_line(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint, "--json", "--count", "1") as process:
        read_line(process)
        robot.status("degraded", "few inliers")
        status = json.loads(printed(process))
        robot.pose(1.0)
        pose = json.loads(printed(process))
    assert (status["kind"], status["state"]) == ("status", "degraded")
    assert status["latency"]["fps"] == 30.0
    assert (pose["kind"], pose["seq"], pose["epoch"]) == ("pose", 7, 2)
    assert pose["position_m"] == [1.0, 0.5, -0.25]
    assert pose["quaternion_xyzw"] == [0.0, 0.0, 0.0, 1.0]


def test_only_changes_of_status_are_printed(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint) as process:
        read_line(process)
        robot.status("lost", "too few matches")
        robot.status("lost", "too few matches")
        robot.status("tracking", "")
        assert read_line(process) == "listen: status lost: too few matches\n"
        assert read_line(process) == "listen: status tracking\n"


def test_a_correction_of_the_map_is_printed_once(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint) as process:
        read_line(process)
        robot.map_odom(0, loop_closures=0)
        for seq in range(3):
            robot.map_odom(seq)
        robot.map_odom(4, map_keyframes=10)
        robot.map_odom(5, is_localized=False)
        assert read_line(process) == (
            "listen: map: 9 keyframes, 1 loop closures; odom at 0.5000 0.2500 0.0000 "
            "0.00000 0.00000 0.00000 1.00000\n"
        )
        assert read_line(process) == (
            "listen: map: 9 keyframes; its transform to odom is unknown\n"
        )


def test_json_has_each_change_of_the_map(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint, "--json") as process:
        read_line(process)
        for seq, places in ((0, 9), (1, 9), (2, 10)):
            robot.map_odom(seq, map_keyframes=places)
        found = [json.loads(printed(process)) for _ in range(2)]
    assert [(each["kind"], each["seq"], each["map_keyframes"]) for each in found] == [
        ("map_odom", 0, 9), ("map_odom", 2, 10),
    ]  # fmt: skip
    assert found[0]["position_m"] == [0.5, 0.25, 0.0]
    assert (found[0]["frame_id"], found[0]["child_frame_id"]) == ("map", "odom")


def test_it_waits_for_a_publisher_and_reconnects(endpoint: str) -> None:
    with listener(endpoint, "--count", "2") as process:
        assert read_line(process) == f"listen: waiting for kinect at {endpoint} (Ctrl-C ends)\n"
        with publisher(endpoint) as robot:
            assert "listening to" in read_line(process)
            robot.pose(1.0)
            assert printed(process).endswith("tracking\n")
        assert "disconnected" in read_line(process)
        with publisher(endpoint) as robot:
            assert "listening to" in read_line(process)
            robot.pose(1.0)
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


def test_a_closed_reader_ends_it_quietly(endpoint: str) -> None:
    with publisher(endpoint) as robot, listener(endpoint) as process:
        read_line(process)
        assert process.stdout is not None
        process.stdout.close()
        robot.pose(1.0)
        assert process.wait(100) == 0
        assert process.stderr is not None
        assert process.stderr.read() == ""

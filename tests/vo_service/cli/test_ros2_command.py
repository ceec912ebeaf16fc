"""`kinect-vo ros2`: it starts the program of the other distribution."""

import os
from pathlib import Path

import pytest

from tests.vo_service.cli.cli_runner import KinectVo, assert_one_line, run_subprocess


@pytest.mark.subprocess
def test_the_node_gets_the_service_and_the_arguments_of_ros(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "kinect-vo-ros2"
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    outcome = run_subprocess("ros2", "--prefix", "7", "--", "--ros-args", "-r", "odom:=vo")
    assert outcome.out.split("\n")[:-1] == [
        "--ros-args",
        *("-p", 'connect:="tcp/127.0.0.1:7450"'),
        *("-p", 'prefix:="7"'),
        *("-p", 'config_file:=""'),
        *("--", "--ros-args", "-r", "odom:=vo"),
    ]


def test_without_the_node_one_line_says_what_to_install(
    kinect_vo: KinectVo, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")
    message = (
        "kinect-vo-ros2 is not installed: with ROS 2 sourced, run python3 -m pip install "
        "kinect-vo-ros2 (docs/guide/ros2.md)"
    )
    assert_one_line(kinect_vo("ros2"), 1, message)

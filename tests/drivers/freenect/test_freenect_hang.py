"""libfreenect asks for ever where a Kinect answers with no bytes: in a process of its own."""

import os
import subprocess
import sys

import pytest

from tests.simulators.kinect_simulator import KinectSimulator

pytestmark = pytest.mark.subprocess

HANGS = "libfreenect hangs: the Kinect does not answer; unplug it and start this program again"
LIMIT_S = 100.0


def started(kinect: KinectSimulator, argument: str) -> "subprocess.Popen[str]":
    return subprocess.Popen(
        [sys.executable, "-m", "tests.drivers.freenect.hung_kinect", argument],
        env=os.environ | kinect.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )


def test_a_hang_while_opening_times_out_and_is_reported(kinect: KinectSimulator) -> None:
    kinect.freeze_control()
    with started(kinect, "open") as process:
        output, _ = process.communicate(timeout=LIMIT_S)
    assert output.splitlines() == [HANGS, HANGS]
    assert process.returncode == 0


def test_a_hang_while_closing_does_not_block_the_caller(kinect: KinectSimulator) -> None:
    with started(kinect, "close") as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "streams\n"
        kinect.freeze_control()
        output, _ = process.communicate("go on\n", timeout=LIMIT_S)
    assert output.splitlines() == [HANGS, HANGS]
    assert process.returncode == 0

"""The whole line: a stranger's process gets every pose of a replay, in order, to the last digit."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from drivers.core.geometry import (
    T_BODY_CAMERA,
    Array,
    Trajectory,
    inverse,
    read_trajectory,
    transform_from_pose,
)
from tests.conftest import FRAMES
from tests.ports import is_listening
from tests.vo_service.cli.cli_runner import running_subprocess
from tests.waiting import wait_until

pytestmark = pytest.mark.subprocess

READER = Path(__file__).parents[1] / "outputs" / "zenoh" / "plain_zenoh_reader.py"
ROS = get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture
def received(
    recording: Path, tmp_path: Path, config: Path, port: int
) -> tuple[list[Any], Trajectory]:
    """What a stranger got of a replay, and the trajectory that the replay wrote."""
    written = tmp_path / "poses.txt"
    with config.open("a") as file:
        file.write('\n[ros2]\nodom_frame_id = "robot1/odom"\n')
    options = ("--config", config, "--wait-for-subscriber", "20", "--trajectory", written)
    with running_subprocess("replay", recording, *options) as replay:
        wait_until(lambda: is_listening(port))
        command = [sys.executable, str(READER), str(port), str(FRAMES), "0.02"]
        reader = subprocess.run(command, capture_output=True, text=True, timeout=100, check=True)
        assert replay.wait(100) == 0
    return json.loads(reader.stdout.splitlines()[1]), read_trajectory(written)


def by_rosbags(sample: dict[str, Any]) -> Any:
    return ROS.deserialize_cdr(bytes.fromhex(sample["payload"]), "nav_msgs/msg/Odometry")


def pose_of(message: Any) -> Array:
    at, turned = message.pose.pose.position, message.pose.pose.orientation
    return transform_from_pose([at.x, at.y, at.z], [turned.x, turned.y, turned.z, turned.w])


def test_a_separate_subscriber_gets_every_pose_in_order_with_the_numbers_of_the_file(
    received: tuple[list[Any], Trajectory],
) -> None:
    samples, trajectory = received
    assert [sample["attachment"]["seq"] for sample in samples] == list(range(FRAMES))
    assert {sample["attachment"]["state"] for sample in samples} == {"tracking"}
    for sample, stamp_s, T in zip(
        samples, trajectory.stamps_s, trajectory.T_world_camera, strict=True
    ):
        message = by_rosbags(sample)
        assert message.header.frame_id == "robot1/odom"
        assert message.child_frame_id == "base_link"
        assert message.header.stamp.sec + message.header.stamp.nanosec * 1e-9 == pytest.approx(
            stamp_s, abs=1e-6
        )
        in_odom_axes = T_BODY_CAMERA @ T @ inverse(T_BODY_CAMERA)
        np.testing.assert_allclose(pose_of(message), in_odom_axes, atol=1e-7)
        for numbers in (message.pose.covariance, message.twist.covariance):
            assert np.linalg.eigvalsh(numbers.reshape(6, 6))[0] > 0

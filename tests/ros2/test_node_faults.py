"""What can go wrong around the node, and what it opens to the network."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tests.ports import listening_addresses, open_sockets
from tests.resource_leaks import open_files
from tests.ros2.kinect_vo_service import KinectVo
from tests.ros2.running_node import ROOT, Ros
from tests.vo_service.security.conftest import keys, network, robot
from tests.vo_service.security.tls_network import TlsNetwork, TlsRobot
from tests.waiting import wait_until

__all__ = ["keys", "network", "robot"]

pytestmark = [pytest.mark.zenoh, pytest.mark.subprocess]

IMAGE = "/camera/rgb/image_raw"
# 127.0.0.1 as the kernel's tables write it.
LOOPBACK = "0100007F"


def bound_addresses(pid: int) -> list[str]:
    """Local addresses of the sockets over UDP that messages can come to: ADDRESS:PORT."""
    inodes = {file[8:-1] for file in open_files(pid) if file.startswith("socket:[")}
    return [row[1] for row in open_sockets("udp", "udp6") if row[9] in inodes]


def test_a_reader_that_hangs_delays_nobody(port: int, service: KinectVo, ros: Ros) -> None:
    words = (f"{IMAGE}=sensor_msgs/Image", "/odom=nav_msgs/Odometry")
    with ros.node(port), ros.reader(1000, *words) as stalled, ros.reader(1000, *words) as reader:
        stalled.first(IMAGE)
        reader.first(IMAGE)
        reader.first("/odom")
        stalled.process.send_signal(signal.SIGSTOP)
        before = {topic: len(messages) for topic, messages in reader.messages.items()}
        wait_until(lambda: len(reader.messages["/odom"]) > before["/odom"] + 60)
        assert len(reader.messages[IMAGE]) > before[IMAGE] + 30


def test_kinect_vo_does_not_notice_that_the_node_is_killed(
    port: int, service: KinectVo, ros: Ros
) -> None:
    with ros.node(port) as node:
        node.wait_for_line("connected")
        with ros.reader(1, f"{IMAGE}=sensor_msgs/Image") as reader:
            reader.first(IMAGE)
            node.process.kill()
            wait_until(lambda: not service.is_wanted("color/image"))
    assert service.poses.errors == service.poses.dropped == 0
    with ros.node(port), ros.reader(1, "/odom=nav_msgs/Odometry") as reader:
        reader.first("/odom")


def test_a_killed_node_leaves_no_settings_of_the_middleware(
    port: int, service: KinectVo, ros: Ros, tmp_path: Path
) -> None:
    there = replace(ros, environment={**ros.environment, "TMPDIR": str(tmp_path)})
    with there.node(port) as node:
        node.wait_for_line("connected")
        node.process.kill()
    assert list(tmp_path.glob("*.xml")) == []


def test_a_reader_without_rights_gets_poses_and_a_refusal(
    network: TlsNetwork, robot: TlsRobot, ros: Ros
) -> None:
    file = network.file("reader-tls.json5", "ours/reader")
    word = "/odom=nav_msgs/Odometry"
    with ros.node(0, config_file=str(file)), ros.reader(1, word) as reader:
        reader.first("/odom")
        answer = ros.run("call", "/kinect_vo/reset", "Trigger")
    assert answer == "False no kinect-vo answers: none is running, or access is denied\n"
    assert robot.executed == []


def test_nothing_listens_beyond_this_computer(port: int, service: KinectVo, ros: Ros) -> None:
    own = {k: v for k, v in ros.environment.items() if k != "ROS_AUTOMATIC_DISCOVERY_RANGE"}
    with (
        Ros(ros.python, own).node(port) as node,
        ros.reader(1, "/odom=nav_msgs/Odometry") as reader,
    ):
        reader.first("/odom")
        assert listening_addresses(node.process.pid) == set()
        bound = bound_addresses(node.process.pid)
        unicast = [address for address in bound if int(address.split(":")[1], 16) < 32768]
    assert unicast
    assert {address.split(":")[0] for address in unicast} == {LOOPBACK}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "rclpy is missing: source a ROS 2 installation (source /opt/ros/DISTRO/setup.sh)"),
        (
            "raise ImportError('no C extension for this Python')",
            f"ROS 2 cannot be loaded by this Python {sys.version_info[0]}.{sys.version_info[1]}: "
            "no C extension for this Python; install kinect-vo-ros2 for the Python of your ROS",
        ),
    ],
)
def test_a_missing_ros_is_one_line(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        (tmp_path / "rclpy.py").write_text(content)
    done = subprocess.run(
        [sys.executable, "-m", "kinect_vo_ros2"],
        env={"PYTHONPATH": f"{ROOT / 'ros2'}:{tmp_path}"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (1, f"kinect-vo-ros2: error: {message}\n")

"""Services, parameters and diagnostics of the node, used by a real rclpy in another process."""

import subprocess
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from drivers.camera import Led
from drivers.ros_messages.cdr import CdrWriter
from tests.ros2.kinect_vo_service import KinectVo, running_kinect_vo
from tests.ros2.running_node import ROOT, Ros
from tests.waiting import wait_until
from vo_service.types.commands import (
    LedCommand,
    LoadMapCommand,
    PauseCommand,
    ResetCommand,
    SaveMapCommand,
    StartRecordingCommand,
    TiltCommand,
)
from vo_service.types.odometry_update import TrackingState

pytestmark = [pytest.mark.zenoh, pytest.mark.subprocess]

MESSAGES = get_typestore(Stores.ROS2_JAZZY)
DIAGNOSTICS = "/diagnostics=diagnostic_msgs/DiagnosticArray"


def pose_message(frame_id: str, x_m: float) -> bytes:
    writer = CdrWriter()
    writer.header(0.0, frame_id)
    writer.float64s(np.array([x_m, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, *np.zeros(36)]))
    return writer.to_bytes()


def newest_tasks(messages: dict[str, list[bytes]]) -> dict[str, Any]:
    """The tasks of the last message."""
    payloads = messages.get("/diagnostics", [])
    if not payloads:
        return {}
    array: Any = MESSAGES.deserialize_cdr(payloads[-1], "diagnostic_msgs/msg/DiagnosticArray")
    return {each.name: each for each in array.status}


def test_services_send_commands(port: int, service: KinectVo, ros: Ros) -> None:
    with ros.node(port, map_name="kitchen") as node:
        node.wait_for_line("connected")
        assert ros.run("call", "/kinect_vo/reset_odom", "Empty") == "None \n"
        assert ros.run("call", "/kinect_vo/pause", "Trigger") == "True paused True\n"
        for name in ("save_map", "load_map", "start_recording"):
            assert ros.run("call", f"/kinect_vo/{name}", "Trigger").startswith("True")
    reset, pause, save, load, record = service.executed
    assert (reset, pause) == (ResetCommand(), PauseCommand())
    assert (save, load) == (SaveMapCommand("kitchen"), LoadMapCommand("kitchen"))
    assert isinstance(record, StartRecordingCommand)  # named after date and time


def test_a_refusal_has_the_message_of_kinect_vo(port: int, service: KinectVo, ros: Ros) -> None:
    service.refusal = "nothing is being recorded"
    with ros.node(port) as node:
        node.wait_for_line("connected")
        answer = ros.run("call", "/kinect_vo/stop_recording", "Trigger")
        assert answer == "False nothing is being recorded\n"
        ros.run("call", "/kinect_vo/pause_odom", "Empty")
        node.wait_for_line("pause: nothing is being recorded")
        assert "map_name" in ros.run("call", "/kinect_vo/load_map", "Trigger")


def test_parameters_set_the_sensor(port: int, service: KinectVo, ros: Ros) -> None:
    with ros.node(port, led="red") as node:
        node.wait_for_line("connected")
        wait_until(lambda: bool(service.executed))  # what was given at the start
        assert ros.run("set", "/kinect_vo", "tilt_deg", "10") == "True \n"
        assert "tilt_deg" in ros.run("set", "/kinect_vo", "tilt_deg", "90")
        service.refusal = "synthetic: it has no LED"
        assert ros.run("set", "/kinect_vo", "led", '"green"') == f"False {service.refusal}\n"
        assert ros.run("set", "/kinect_vo", "prefix", '"other"').startswith("False")
    assert service.executed[:2] == [LedCommand(Led.RED), TiltCommand(10.0)]


def test_a_pose_is_set_by_topic(port: int, service: KinectVo, ros: Ros) -> None:
    kind = "geometry_msgs/PoseWithCovarianceStamped"
    with ros.node(port) as node:
        node.wait_for_line("connected")
        ros.run("send", "/set_pose", kind, pose_message("map", 1.0).hex())
        node.wait_for_line("the pose is in 'map'; give it in 'odom'")
        ros.run("send", "/set_pose", kind, pose_message("odom", 2.0).hex())
        wait_until(lambda: bool(service.executed))
    (command,) = service.executed
    assert isinstance(command, ResetCommand)
    assert command.position_m == (2.0, 0.0, 0.0)


def test_the_end_of_kinect_vo_is_an_error_until_it_is_back(port: int, ros: Ros) -> None:
    with ros.node(port) as node, ros.reader(1000, DIAGNOSTICS) as reader:
        node.wait_for_line("no kinect-vo there; waiting for it")
        for _ in range(2):
            with running_kinect_vo(port) as service:
                service.status = replace(service.status, state=TrackingState.TRACKING)
                wait_until(lambda: "kinect_vo: tracking" in newest_tasks(reader.messages))
                assert ros.run("call", "/kinect_vo/reset", "Trigger").startswith("True")
            wait_until(lambda: newest_tasks(reader.messages).keys() == {"kinect_vo: service"})
            task = newest_tasks(reader.messages)["kinect_vo: service"]
            assert task.level == 2
            assert "kinect-vo has ended or cannot be reached" in task.message
        answer = ros.run("call", "/kinect_vo/reset", "Trigger")
        assert answer == "False no kinect-vo answers: none is running, or access is denied\n"


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_the_node_ends_with_code_0(port: int, service: KinectVo, ros: Ros, name: str) -> None:
    with ros.node(port) as node:
        node.wait_for_line("connected")
        node.stop(name)
        assert node.process.wait(20) == 0
    assert not any("Traceback" in line for line in node.lines)


SIGNAL_BEFORE_THE_WAIT = """
import rclpy
from rclpy.executors import MultiThreadedExecutor

from kinect_vo_ros2.__main__ import main

MultiThreadedExecutor.spin = lambda self: (rclpy.shutdown(), self.spin_once())
main([])
"""


def test_a_signal_just_before_the_executor_waits_is_no_error(ros: Ros) -> None:
    environment = {**ros.environment, "PYTHONPATH": str(ROOT / "ros2")}
    command = [str(ros.python), "-c", SIGNAL_BEFORE_THE_WAIT]
    subprocess.run(command, env=environment, check=True, timeout=60)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"connect": "nowhere"}, "connect = 'nowhere': an endpoint is written PROTOCOL/ADDRESS"),
        ({"config_file": "/none.json5"}, "config_file: /none.json5: cannot be read"),
        ({"publish_tf": 3}, "publish_tf"),
    ],
)
def test_a_wrong_parameter_is_one_line(
    port: int, ros: Ros, parameters: dict[str, object], message: str
) -> None:
    with ros.node(port, **parameters) as node:
        assert node.process.wait(60) == 2
    (line,) = node.lines
    assert line.startswith("kinect-vo-ros2: error: ")
    assert message in line

"""Frames for ROS 2: keys, tokens, attachments and /tf_static, as a node sees them through Zenoh."""

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh
import zenoh.ext

from drivers.core.geometry import rigid_transform, transform_from_pose
from drivers.ros_messages.cdr import split_stamp
from drivers.ros_messages.navigation import TRANSFORMS_SCHEMA
from tests.ports import free_port
from tests.vo_service.outputs.conftest import make_update
from tests.vo_service.outputs.frames.frame_robot import (
    T_BASE_CAMERA,
    MakeUpdate,
    Robot,
    running_robot,
)
from tests.vo_service.outputs.zenoh.ros_node import ROS, RosReader, receive_tokens, ros_node
from tests.waiting import wait_until
from vo_service.config_tables import Ros2Config
from vo_service.outputs.zenoh.ros2 import TF_MESSAGE, ros_type

__all__ = ["make_update"]

pytestmark = pytest.mark.zenoh

TOPICS = {
    "camera/rgb/image_raw": "sensor_msgs/msg/Image",
    "camera/rgb/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "camera/rgb/camera_info": "sensor_msgs/msg/CameraInfo",
    "camera/depth_registered/image_raw": "sensor_msgs/msg/Image",
    "camera/depth_registered/image_raw/compressedDepth": "sensor_msgs/msg/CompressedImage",
    "camera/depth_registered/camera_info": "sensor_msgs/msg/CameraInfo",
    "camera/depth_registered/points": "sensor_msgs/msg/PointCloud2",
    "camera/imu": "sensor_msgs/msg/Imu",
    "scan": "sensor_msgs/msg/LaserScan",
}


def rmw_key(topic: str) -> str:
    kind = ros_type(TOPICS[topic])
    return f"0/{topic}/{kind.dds_name}/{kind.hash}"


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def robot(port: int, make_update: MakeUpdate) -> Iterator[Robot]:
    with running_robot(port, make_update, ros2=Ros2Config(enabled=True)) as made:
        yield made


@pytest.fixture
def node(robot: Robot, port: int) -> Iterator[zenoh.Session]:
    with ros_node(port) as session:
        yield session


def received(robot: Robot, node: zenoh.Session, keys: list[str]) -> dict[str, zenoh.Sample]:
    reader = RosReader(node, *keys)
    wanted = [key for publisher in robot.frames._publishers for key in publisher._keys]
    wait_until(lambda: sum(key.is_wanted for key in wanted) == len(keys))
    robot.publish()
    return {str(sample.key_expr): sample for sample in reader.first(len(keys))}


def test_a_node_receives_every_topic_with_one_stamp_and_frame(
    robot: Robot, node: zenoh.Session
) -> None:
    samples = received(robot, node, [rmw_key(topic) for topic in TOPICS])
    headers = []
    for topic, schema in TOPICS.items():
        payload = samples[rmw_key(topic)].payload.to_bytes()
        message: Any = ROS.deserialize_cdr(payload, schema)
        headers.append(message.header)
    frame_ids = [header.frame_id for header in headers]
    assert frame_ids == [*["camera_rgb_optical_frame"] * (len(TOPICS) - 1), "camera_scan"]
    assert len({(header.stamp.sec, header.stamp.nanosec) for header in headers}) == 1
    assert headers[0].stamp.nanosec == split_stamp(robot._make_update(0).stamp_s)[1]


def test_samples_of_rmw_zenoh_are_numbered_and_signed(robot: Robot, node: zenoh.Session) -> None:
    key = rmw_key("camera/rgb/camera_info")
    attachment = received(robot, node, [key])[key].attachment
    assert attachment is not None
    number, source_ns, length = struct.unpack_from("<qqB", attachment.to_bytes())
    assert (number, length, len(attachment.to_bytes())) == (1, 16, 33)
    assert source_ns > 1_700_000_000_000_000_000


def test_the_bridge_receives_every_topic_under_its_name(robot: Robot, node: zenoh.Session) -> None:
    samples = received(robot, node, list(TOPICS))
    assert samples.keys() == TOPICS.keys()


def test_a_node_discovers_every_topic_with_its_type(robot: Robot, node: zenoh.Session) -> None:
    # the node, odometry, /tf, /tf_static twice and the topics of the frames
    tokens = receive_tokens(node, 0, 5 + len(TOPICS))
    for topic, schema in TOPICS.items():
        kind, name = ros_type(schema), "%" + topic.replace("/", "%")
        assert ("MP", f"{name}/{kind.dds_name}/{kind.hash}/::,1:,:,:,,") in tokens
    latched = f"%tf_static/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}/:1:,1:,:,:,,"
    assert ("MP", latched) in tokens


@pytest.mark.subprocess
def test_another_implementation_discovers_and_receives_every_topic(
    robot: Robot, port: int, tmp_path: Path
) -> None:
    names = [f"/{topic}" for topic in TOPICS]
    command = ["tests.vo_service.outputs.frames.ros2_sdk_reader", str(port), str(tmp_path), *names]
    pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-m", *command], **pipes) as reader:
        assert reader.stdout is not None
        found = json.loads(reader.stdout.readline())
        assert found == {
            **{f"/{topic}": [schema] for topic, schema in TOPICS.items()},
            "/tf": ["tf2_msgs/msg/TFMessage"],
            "/tf_static": ["tf2_msgs/msg/TFMessage"],
            "/vo/odom": ["nav_msgs/msg/Odometry"],
        }
        assert reader.stdout.readline() == "ready\n"
        wait_until(lambda: all(robot.is_wanted(topic.name) for topic in robot.frames._topics[1:]))
        robot.publish()
        lines = {reader.stdout.readline() for _ in names}
        frame_ids = {"/scan": "camera_scan"}
        assert lines == {
            f"{name} {frame_ids.get(name, 'camera_rgb_optical_frame')}\n" for name in names
        }
        reader.communicate("")


def test_a_late_node_gets_the_static_transforms(robot: Robot, node: zenoh.Session) -> None:
    payloads: list[bytes] = []
    subscriber = zenoh.ext.declare_advanced_subscriber(
        node,
        f"0/tf_static/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}",
        lambda sample: payloads.append(sample.payload.to_bytes()),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
    )
    bridge = RosReader(node, "tf_static")
    wait_until(lambda: len(payloads) == 2)
    for received in (payloads, [sample.payload.to_bytes() for sample in bridge.first(2)]):
        transforms = {}
        for payload in received:
            message: Any = ROS.deserialize_cdr(payload, TRANSFORMS_SCHEMA)
            (stamped,) = message.transforms
            assert stamped.header.frame_id == "base_link"
            q, t = stamped.transform.rotation, stamped.transform.translation
            T_base_child = transform_from_pose((t.x, t.y, t.z), (q.x, q.y, q.z, q.w))
            transforms[stamped.child_frame_id] = T_base_child
        assert transforms.keys() == {"camera_rgb_optical_frame", "camera_scan"}
        np.testing.assert_allclose(
            transforms["camera_rgb_optical_frame"], T_BASE_CAMERA, atol=1e-12
        )
        T_base_scan = rigid_transform(np.eye(3), (0.1, 0.0, 0.2))
        np.testing.assert_allclose(transforms["camera_scan"], T_base_scan, atol=1e-12)
    subscriber.undeclare()  # type: ignore[no-untyped-call]


def test_without_ros2_no_token_is_declared(port: int, make_update: MakeUpdate) -> None:
    with running_robot(port, make_update), ros_node(port) as node:
        wait_until(lambda: bool(node.info.links()))
        assert list(node.liveliness().get("@ros2_lv/**", timeout=60)) == []

"""Topics of the node, read by a real rclpy in another process."""

from dataclasses import replace

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from drivers.core.geometry import rigid_transform
from drivers.ros_messages.navigation import (
    OdometryMessage,
    encode_odometry,
    encode_twist,
)
from tests.ros2.conftest import find_python
from tests.ros2.kinect_vo_service import KinectVo
from tests.ros2.running_node import Ros
from tests.vo_service.outputs.sample_updates import make_update
from tests.vo_service.outputs.zenoh.query_helpers import connected_session
from tests.vo_service.sample_map import make_map
from tests.waiting import wait_until
from vo_service.config_tables import FrameIds
from vo_service.types.messages import pose_attachment, pose_payload
from vo_service.types.occupancy_grid import FREE, OCCUPIED, OccupancyGrid

pytestmark = [pytest.mark.zenoh, pytest.mark.subprocess]

MESSAGES = get_typestore(Stores.ROS2_JAZZY)
RGB, DEPTH = "/camera/rgb", "/camera/depth_registered"
FRAME_TOPICS = {
    f"{RGB}/image_raw": ("color/image", "sensor_msgs/Image"),
    f"{RGB}/image_raw/compressed": ("color/compressed", "sensor_msgs/CompressedImage"),
    f"{RGB}/camera_info": ("color/camera_info", "sensor_msgs/CameraInfo"),
    f"{DEPTH}/image_raw": ("depth/image", "sensor_msgs/Image"),
    f"{DEPTH}/image_raw/compressedDepth": ("depth/compressed", "sensor_msgs/CompressedImage"),
    f"{DEPTH}/camera_info": ("depth/camera_info", "sensor_msgs/CameraInfo"),
    f"{DEPTH}/points": ("points", "sensor_msgs/PointCloud2"),
    "/camera/imu": ("imu", "sensor_msgs/Imu"),
    "/scan": ("scan", "sensor_msgs/LaserScan"),
}
GRID = OccupancyGrid(np.array([[FREE, OCCUPIED]], np.int8), 0.05, (-1.0, 2.0))


def transforms(payload: bytes) -> dict[tuple[str, str], object]:
    message = MESSAGES.deserialize_cdr(payload, "tf2_msgs/msg/TFMessage")
    found: dict[tuple[str, str], object] = {}
    for each in message.transforms:  # type: ignore[attr-defined]
        found[each.header.frame_id, each.child_frame_id] = each
    return found


def is_one_of(received: bytes, sent: set[bytes]) -> bool:
    """Whether a message was sent; DDS fills it up to four bytes."""
    return any(received == message + bytes(-len(message) % 4) for message in sent)


def test_every_topic_arrives_as_kinect_vo_sent_it(port: int, service: KinectVo, ros: Ros) -> None:
    sent: dict[str, set[bytes]] = {}

    def on_sample(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr).removeprefix("kinect/")
        sent.setdefault(key, set()).add(sample.payload.to_bytes())

    topics = {"/odom": ("odom", "nav_msgs/Odometry")} | FRAME_TOPICS
    words = [f"{topic}={kind}" for topic, (_, kind) in topics.items()]
    with connected_session(port) as session:
        session.declare_subscriber("kinect/**", on_sample)
        wait_until(lambda: len(sent) > len(topics))
        with ros.node(port), ros.reader(1, *words) as reader:
            for topic, (key, _) in topics.items():
                received = reader.first(topic)
                wait_until(lambda key=key, received=received: is_one_of(received, sent[key]))  # type: ignore[misc]


def test_an_image_is_encoded_only_while_somebody_reads_it(
    port: int, service: KinectVo, ros: Ros
) -> None:
    with ros.node(port) as node:
        node.wait_for_line("connected")
        assert not service.is_wanted("color/image")
        with ros.reader(1, f"{RGB}/image_raw=sensor_msgs/Image") as reader:
            reader.first(f"{RGB}/image_raw")
            assert service.is_wanted("color/image")
            assert not service.is_wanted("points")
        wait_until(lambda: not service.is_wanted("color/image"))


def test_a_late_reader_gets_what_is_latched(port: int, service: KinectVo, ros: Ros) -> None:
    service.changes = {"grid": GRID}
    with ros.node(port) as node:
        node.wait_for_line("connected")
        words = ("+/tf_static=tf2_msgs/TFMessage", "+/map=nav_msgs/OccupancyGrid")
        with ros.reader(1, *words) as reader:
            found = transforms(reader.first("/tf_static"))
            grid = MESSAGES.deserialize_cdr(reader.first("/map"), "nav_msgs/msg/OccupancyGrid")
    assert {("base_link", "camera_link"), ("base_link", "camera_scan")} <= found.keys()
    assert ("camera_rgb_frame", "camera_rgb_optical_frame") in found
    np.testing.assert_array_equal(grid.data, GRID.cells.ravel())  # type: ignore[attr-defined]


def test_the_map_has_the_stamp_of_the_pose_on_tf(port: int, service: KinectVo, ros: Ros) -> None:
    service.changes = {"map": make_map(T_map_odom=rigid_transform(np.eye(3), [5, 0, 0]))}
    with ros.node(port), ros.reader(200, "/tf=tf2_msgs/TFMessage") as reader:
        wait_until(lambda: len(transforms(reader.messages.get("/tf", [b""])[-1] or EMPTY)) == 2)
        found = transforms(reader.messages["/tf"][-1])
    base, map_odom = found["odom", "base_link"], found["map", "odom"]
    assert base.header.stamp == map_odom.header.stamp  # type: ignore[attr-defined]
    assert map_odom.transform.translation.x == 5.0  # type: ignore[attr-defined]


def test_a_map_of_another_epoch_is_not_on_tf(port: int, service: KinectVo, ros: Ros) -> None:
    service.changes = {"map": make_map()}
    update = replace(make_update(0), stamp_s=7.5, epoch=99)
    pose = pose_payload(update, FrameIds()), pose_attachment(update)

    def sent_transforms() -> dict[tuple[str, str], object]:
        service.session.put("kinect/odom", pose[0], attachment=pose[1])
        messages = reader.messages.get("/tf", [])
        return next((found for found in map(transforms, messages) if is_at_7_s(found)), {})

    with ros.node(port), ros.reader(1000, "/tf=tf2_msgs/TFMessage") as reader:
        wait_until(lambda: len(transforms(reader.messages.get("/tf", [EMPTY])[-1])) == 2)
        wait_until(sent_transforms)
        assert sent_transforms().keys() == {("odom", "base_link")}


def is_at_7_s(found: dict[tuple[str, str], object]) -> bool:
    return any(each.header.stamp.sec == 7 for each in found.values())  # type: ignore[attr-defined]


# A TFMessage without transforms.
EMPTY = b"\x00\x01\x00\x00\x00\x00\x00\x00"


def test_there_is_no_transform_while_lost(port: int, service: KinectVo, ros: Ros) -> None:
    lost = make_update(0, ok=False)
    service.changes = {"state": lost.state, "reason": lost.reason}
    words = ("/tf=tf2_msgs/TFMessage", "/odom=nav_msgs/Odometry")
    with ros.node(port), ros.reader(20, *words) as reader:
        wait_until(lambda: len(reader.messages.get("/odom", [])) == 20)
        assert "/tf" not in reader.messages
        service.changes = {}
        assert transforms(reader.first("/tf")).keys() == {("odom", "base_link")}


def test_a_replay_gives_the_time(port: int, service: KinectVo, ros: Ros) -> None:
    words = ("/clock=rosgraph_msgs/Clock", "/odom=nav_msgs/Odometry")
    with ros.node(port, publish_clock=True), ros.reader(30, *words) as reader:
        wait_until(lambda: len(reader.messages.get("/clock", [])) == 30)
        stamps = {message[:12] for message in reader.messages["/odom"]}
        assert set(reader.messages["/clock"]) & stamps


@pytest.mark.parametrize(
    ("name", "kind", "payload"),
    [
        ("wheel_odom", "nav_msgs/Odometry", None),
        ("cmd_vel", "geometry_msgs/Twist", encode_twist(np.array([0.2, 0, 0, 0, 0, 0.1]))),
    ],
)
def test_the_base_reaches_kinect_vo(
    port: int, service: KinectVo, ros: Ros, name: str, kind: str, payload: bytes | None
) -> None:
    zeros = np.zeros((6, 6))
    odometry = OdometryMessage(1.5, "odom", "base_link", np.eye(4), zeros, np.zeros(6), zeros)
    payload = payload or encode_odometry(odometry)
    received: list[bytes] = []
    service.session.declare_subscriber(
        f"kinect/{name}", lambda sample: received.append(sample.payload.to_bytes())
    )
    with ros.node(port) as node:
        node.wait_for_line("connected")
        ros.run("send", f"/{name}", kind, payload.hex())
        wait_until(lambda: bool(received))
        if name == "wheel_odom":
            node.wait_for_line("its driver must not publish this transform too")
    assert received == [payload]


def test_what_cannot_be_read_does_not_end_the_node(port: int, service: KinectVo, ros: Ros) -> None:
    with ros.node(port) as node, ros.reader(1000, "/odom=nav_msgs/Odometry") as reader:
        node.wait_for_line("connected")
        ros.run("send", "/wheel_odom", "nav_msgs/Odometry", "00000000ff")
        service.session.put("kinect/status", b'{"schema": 2}')
        node.wait_for_line("the status has version 2, but this node reads only 1")
        service.session.put("kinect/odom", b"no pose")
        service.session.put("kinect/map_odom", b"no map")
        reader.first("/odom")
        count = len(reader.messages["/odom"])
        wait_until(lambda: len(reader.messages["/odom"]) > count + 30)
        assert node.process.poll() is None


@pytest.mark.parametrize("distribution", ["jazzy"])
def test_another_distribution_reads_the_node(
    port: int, service: KinectVo, ros: Ros, distribution: str
) -> None:
    other = Ros(find_python(distribution), ros.environment)
    word = "/odom=nav_msgs/Odometry"
    with ros.node(port), other.reader(1, word) as reader:
        reader.first("/odom")
    with other.node(port) as node, ros.reader(1, word) as reader:
        reader.first("/odom")
        node.wait_for_line("tf2_msgs is not installed")

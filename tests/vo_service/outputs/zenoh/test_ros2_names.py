"""Keys, tokens and attachments of ROS 2, against rosbags and Zenoh's own serialiser."""

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from drivers.core import InputError
from vo_service.outputs.zenoh.ros2 import (
    ODOMETRY,
    TF_MESSAGE,
    RosNode,
    RosTopic,
    RosType,
    encode_attachment,
    node_name,
    publisher_gid,
    ros_type,
)

FRAME_TYPES = [
    f"sensor_msgs/msg/{name}"
    for name in ("Image", "CompressedImage", "CameraInfo", "PointCloud2", "Imu")
]

NODE = RosNode(domain_id=3, zid="1a2b", name="kinect_vo")
TOPIC = RosTopic("robot/vo/odom", ODOMETRY, depth=10)


@pytest.mark.parametrize("store", [Stores.ROS2_JAZZY, Stores.ROS2_KILTED, Stores.ROS2_LYRICAL])
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (ODOMETRY, "nav_msgs/msg/Odometry"),
        (TF_MESSAGE, "tf2_msgs/msg/TFMessage"),
        *((ros_type(name), name) for name in FRAME_TYPES),
    ],
)
def test_the_hashes_are_those_that_rosbags_computes(
    store: Stores, kind: RosType, name: str
) -> None:
    assert kind.hash == get_typestore(store).hash_rihs01(name)
    package, _, message = name.split("/")
    assert kind.dds_name == f"{package}::msg::dds_::{message}_"


def test_each_protocol_has_its_key() -> None:
    assert TOPIC.bridge_key == "robot/vo/odom"
    assert TOPIC.rmw_key(3) == f"3/robot/vo/odom/nav_msgs::msg::dds_::Odometry_/{ODOMETRY.hash}"


def test_tokens_have_the_parts_of_rmw_zenoh() -> None:
    assert NODE.liveliness_token == "@ros2_lv/3/1a2b/0/0/NN/%/%/kinect_vo"
    parts = NODE.publisher_token(1, TOPIC).split("/")
    assert parts[:9] == ["@ros2_lv", "3", "1a2b", "0", "1", "MP", "%", "%", "kinect_vo"]
    assert parts[9:12] == ["%robot%vo%odom", ODOMETRY.dds_name, ODOMETRY.hash]
    assert parts[12:] == ["::,10:,:,:,,"]


def test_keys_and_tokens_are_valid_zenoh_keys() -> None:
    for key in (TOPIC.rmw_key(0), NODE.liveliness_token, NODE.publisher_token(2, TOPIC)):
        assert str(zenoh.KeyExpr(key)) == key


@given(st.integers(1, 2**63 - 1), st.integers(0, 2**63 - 1), st.binary(min_size=16, max_size=16))
def test_an_attachment_has_the_format_of_zenohs_serializer(
    number: int, source_ns: int, gid: bytes
) -> None:
    content = (zenoh.ext.Int64(number), zenoh.ext.Int64(source_ns), gid)
    written = zenoh.ext.z_serialize(content).to_bytes()
    assert encode_attachment(number, source_ns, gid) == written
    assert len(written) == 33


def test_every_publisher_has_its_own_constant_gid() -> None:
    tokens = [NODE.publisher_token(number, TOPIC) for number in (1, 2, 1)]
    first, second, again = (publisher_gid(token) for token in tokens)
    assert first == again != second
    assert len(first) == 16


@pytest.mark.parametrize("name", ["", "/vo/odom", "vo//odom", "vo/", "vo odom", "vo/*", "2vo", "ü"])
def test_an_invalid_ros_topic_is_rejected(name: str) -> None:
    with pytest.raises(InputError, match=r"ros2\.topic"):
        RosTopic(name, ODOMETRY, depth=1)


@pytest.mark.parametrize(
    ("prefix", "name"),
    [("kinect", "kinect_vo"), ("robot-1/kinect", "robot_1_kinect_vo"), ("7.up", "_7_up_vo")],
)
def test_a_node_is_named_after_the_prefix(prefix: str, name: str) -> None:
    assert node_name(prefix) == name

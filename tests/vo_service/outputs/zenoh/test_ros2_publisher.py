"""What a ROS 2 node, or the bridge to DDS, receives over real Zenoh."""

import struct
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import pytest

from drivers.core import InputError
from tests import ports
from tests.vo_service.outputs.zenoh.ros_node import (
    ODOMETRY_KEY,
    ROS,
    ROS_ROUTER,
    TF_KEY,
    RosReader,
    publishing_service,
    receive_published,
    receive_tokens,
    ros_node,
    running_session,
)
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.output import ZenohOutput
from vo_service.outputs.zenoh.ros2 import ODOMETRY, TF_MESSAGE
from vo_service.types.odometry_update import OdometryUpdate

pytestmark = pytest.mark.zenoh

MakeUpdate = Callable[..., OdometryUpdate]


def test_a_node_gets_odometry_under_the_key_of_its_type(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = make_update(3)
    (sample,) = receive_published(free_port, [update], 1, ODOMETRY_KEY)
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "nav_msgs/msg/Odometry")
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert message.pose.pose.position.z == update.T_odom_base[2, 3]
    np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6), update.pose_covariance)


def test_samples_are_numbered_from_1_per_publisher(free_port: int, make_update: MakeUpdate) -> None:
    before_ns = time.time_ns()
    samples = receive_published(free_port, [make_update(seq) for seq in range(3)], 3, ODOMETRY_KEY)
    attachments = [bytes(sample.attachment.to_bytes()) for sample in samples if sample.attachment]
    assert [len(each) for each in attachments] == [33] * 3
    heads = [struct.unpack_from("<qqB", each) for each in attachments]
    assert [head[0] for head in heads] == [1, 2, 3]
    assert all(before_ns <= head[1] <= time.time_ns() and head[2] == 16 for head in heads)
    assert len({each[17:] for each in attachments}) == 1


def test_a_node_gets_the_transform(free_port: int, make_update: MakeUpdate) -> None:
    update = make_update(2)
    (sample,) = receive_published(free_port, [update], 1, TF_KEY)
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "tf2_msgs/msg/TFMessage")
    (transform,) = message.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert transform.transform.translation.x == update.T_odom_base[0, 3]
    assert ROS.serialize_cdr(message, "tf2_msgs/msg/TFMessage") == sample.payload.to_bytes()


def test_the_bridge_gets_the_same_bytes_under_plain_keys(
    free_port: int, make_update: MakeUpdate
) -> None:
    keys = (ODOMETRY_KEY, TF_KEY, "vo/odom", "tf")
    samples = receive_published(free_port, [make_update(1)], 4, *keys)
    payloads = {str(sample.key_expr): sample.payload.to_bytes() for sample in samples}
    assert payloads["vo/odom"] == payloads[ODOMETRY_KEY]
    assert payloads["tf"] == payloads[TF_KEY]


def test_no_transform_is_published_while_lost(free_port: int, make_update: MakeUpdate) -> None:
    updates = [make_update(0, ok=False), make_update(1)]
    samples = receive_published(free_port, updates, 3, "vo/odom", "tf")
    keys = [str(sample.key_expr) for sample in samples]
    assert sorted(keys) == ["tf", "vo/odom", "vo/odom"]
    message: Any = ROS.deserialize_cdr(
        samples[keys.index("tf")].payload.to_bytes(), "tf2_msgs/msg/TFMessage"
    )
    assert message.transforms[0].transform.translation.x == updates[1].T_odom_base[0, 3]


def test_the_topics_are_listed_until_closed(free_port: int) -> None:
    with ros_node(free_port) as node:
        with publishing_service(free_port, domain_id=7, topic="robot/odom"):
            assert receive_tokens(node, 7, count=3) == {
                ("NN", "kinect_vo"),
                ("MP", f"%robot%odom/{ODOMETRY.dds_name}/{ODOMETRY.hash}/::,10:,:,:,,"),
                ("MP", f"%tf/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}/::,100:,:,:,,"),
            }
        assert receive_tokens(node, 7, count=0) == set()


def test_without_tf_there_is_no_tf_topic(free_port: int) -> None:
    with publishing_service(free_port, tf=False), ros_node(free_port) as node:
        assert {kind for kind, _ in receive_tokens(node, 0, count=2)} == {"NN", "MP"}


def test_a_node_connects_beside_its_own_router(free_port: int, make_update: MakeUpdate) -> None:
    router_port = ports.free_port()
    router = running_session(ROS_ROUTER | {"listen/endpoints": [f"tcp/127.0.0.1:{router_port}"]})
    with router, publishing_service(free_port) as ours, ros_node(router_port, free_port) as node:
        reader = RosReader(node, ODOMETRY_KEY)
        ours.wait_for_readers(ODOMETRY_KEY)
        ours.publish(make_update(0))
        assert len(reader.first(1)) == 1


def test_a_key_in_use_is_rejected(free_port: int) -> None:
    with (
        pytest.raises(InputError, match="already use this key"),
        publishing_service(free_port, topic="kinect/odom"),
    ):
        pass


def test_nothing_is_declared_unless_enabled(free_port: int, make_update: MakeUpdate) -> None:
    config = ZenohConfig(listen=(f"tcp/127.0.0.1:{free_port}",))
    with closing(ZenohOutput(config)) as output, ros_node(free_port) as node:
        output.on_update(make_update(0))
        assert receive_tokens(node, 0, count=0) == set()

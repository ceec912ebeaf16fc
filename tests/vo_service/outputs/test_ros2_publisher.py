"""What a ROS 2 node, or the bridge to DDS, would find of us on a real Zenoh."""

import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zenoh
from rosbags.typesys import Stores, get_typestore

from drivers.errors import InputError
from drivers.geometry import rigid_transform
from tests.vo_service.fakes import a_map
from tests.vo_service.played_service import free_port as another_free_port
from vo_service.outputs.map_snapshot import NO_MAP, MapSnapshot
from vo_service.outputs.output import PoseUpdate
from vo_service.outputs.ros2_names import ODOMETRY, TF_MESSAGE
from vo_service.outputs.ros2_publisher import Ros2Publisher, ros2_output
from vo_service.outputs.zenoh_messages import Frames, pose_payload
from vo_service.outputs.zenoh_session import ZenohConfig, open_session
from vo_service.settings import Ros2Settings

MakeUpdate = Callable[..., PoseUpdate]
ROS = get_typestore(Stores.ROS2_JAZZY)
FRAMES = Frames("odom", "base_link", "map")
ODOMETRY_KEY = f"0/vo/odom/{ODOMETRY.dds_name}/{ODOMETRY.hash}"
TF_KEY = f"0/tf/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}"
# As rmw_zenoh opens its sessions and its router; routers there do not stand in between peers.
ROS_SESSION = {
    "mode": "peer",
    "scouting/multicast/enabled": False,
    "scouting/gossip/target": {"router": ["router", "peer"], "peer": ["router"]},
    "scouting/gossip/autoconnect_strategy": {
        "peer": {"to_router": "always", "to_peer": "greater-zid"}
    },
    "transport/shared_memory/enabled": False,
    "listen/endpoints": ["tcp/127.0.0.1:0"],
}
ROS_ROUTER = ROS_SESSION | {"mode": "router", "routing/router/peers_failover_brokering": False}


@contextmanager
def session(settings: dict[str, Any]) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as opened:
        yield opened


class Reader:
    """Hears some keys on a session, and waits for what it is told to."""

    def __init__(self, on: zenoh.Session, *keys: str) -> None:
        self.heard: list[zenoh.Sample] = []
        self._news = threading.Condition()
        for key in keys:
            on.declare_subscriber(key, self._take)

    def _take(self, sample: zenoh.Sample) -> None:
        with self._news:
            self.heard.append(sample)
            self._news.notify_all()

    def first(self, count: int) -> list[zenoh.Sample]:
        with self._news:
            assert self._news.wait_for(lambda: len(self.heard) >= count, 10), len(self.heard)
            return self.heard[:count]


class Publishing:
    """The publisher, and the session of the service that it is on."""

    def __init__(self, session: zenoh.Session, settings: Ros2Settings) -> None:
        congestion = zenoh.CongestionControl.BLOCK
        self._session = session
        self.publisher = Ros2Publisher(session, settings, "kinect", FRAMES, congestion)

    def publish(self, update: PoseUpdate) -> None:
        self.publisher.publish(update, pose_payload(update, FRAMES))

    def wait_for_readers(self, *keys: str) -> None:
        """Until someone on the network wants each of these."""
        deadline_s = time.monotonic() + 100
        for key in keys:
            with self._session.declare_publisher(key) as probe:
                while not probe.matching_status.matching:  # type: ignore[attr-defined]
                    assert time.monotonic() < deadline_s, f"nobody wants {key}"
                    time.sleep(0.01)


@contextmanager
def publishing(port: int, **changes: Any) -> Iterator[Publishing]:
    """A publisher on a session as the service opens it."""
    with open_session(ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",))) as ours:
        publishing = Publishing(ours, Ros2Settings(enabled=True, **changes))
        yield publishing
        publishing.publisher.close()


@contextmanager
def ros_node(*connect: int) -> Iterator[zenoh.Session]:
    """The session of a ROS 2 node that connects to these ports."""
    endpoints = [f"tcp/127.0.0.1:{port}" for port in connect]
    with session(ROS_SESSION | {"connect/endpoints": endpoints}) as opened:
        yield opened


def published(
    port: int, updates: list[PoseUpdate], count: int, *keys: str, **changes: Any
) -> list[zenoh.Sample]:
    """The first samples that a node hears on these keys when we publish these poses."""
    with publishing(port, **changes) as ours, ros_node(port) as node:
        reader = Reader(node, *keys)
        ours.wait_for_readers(*keys)
        for update in updates:
            ours.publish(update)
        return reader.first(count)


def test_a_node_gets_odometry_under_the_key_of_its_type(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = make_update(3)
    (sample,) = published(free_port, [update], 1, ODOMETRY_KEY)
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "nav_msgs/msg/Odometry")
    assert (message.header.frame_id, message.child_frame_id) == ("odom", "base_link")
    assert message.pose.pose.position.z == update.T_odom_base[2, 3]
    np.testing.assert_array_equal(message.pose.covariance.reshape(6, 6), update.pose_covariance)


def test_samples_are_numbered_from_1_by_one_publisher(
    free_port: int, make_update: MakeUpdate
) -> None:
    before_ns = time.time_ns()
    samples = published(free_port, [make_update(seq) for seq in range(3)], 3, ODOMETRY_KEY)
    attachments = [bytes(sample.attachment.to_bytes()) for sample in samples if sample.attachment]
    assert [len(each) for each in attachments] == [33] * 3
    heads = [struct.unpack_from("<qqB", each) for each in attachments]
    assert [head[0] for head in heads] == [1, 2, 3]
    assert all(before_ns <= head[1] <= time.time_ns() and head[2] == 16 for head in heads)
    assert len({each[17:] for each in attachments}) == 1


def test_a_node_gets_the_transform(free_port: int, make_update: MakeUpdate) -> None:
    update = make_update(2)
    (sample,) = published(free_port, [update], 1, TF_KEY)
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "tf2_msgs/msg/TFMessage")
    (transform,) = message.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("odom", "base_link")
    assert transform.transform.translation.x == update.T_odom_base[0, 3]
    assert ROS.serialize_cdr(message, "tf2_msgs/msg/TFMessage") == sample.payload.to_bytes()


def transforms(sample: zenoh.Sample) -> list[tuple[str, str, float]]:
    """Frames and x of each transform of a sample, which all have one stamp."""
    message: Any = ROS.deserialize_cdr(sample.payload.to_bytes(), "tf2_msgs/msg/TFMessage")
    assert len({(t.header.stamp.sec, t.header.stamp.nanosec) for t in message.transforms}) == 1
    return [
        (t.header.frame_id, t.child_frame_id, t.transform.translation.x) for t in message.transforms
    ]


def test_where_there_is_a_map_a_node_gets_odom_in_it_beside_the_base(
    free_port: int, make_update: MakeUpdate
) -> None:
    update = replace(make_update(2), map=a_map(T_map_odom=rigid_transform(np.eye(3), [5, 0, 0])))
    (sample,) = published(free_port, [update], 1, TF_KEY)
    assert transforms(sample) == [
        ("odom", "base_link", update.T_odom_base[0, 3]),
        ("map", "odom", 5.0),
    ]


@pytest.mark.parametrize(
    "the_map",
    [
        NO_MAP,
        a_map(is_located=False),
        a_map(epoch=0),
        a_map(T_map_odom=np.full((4, 4), np.nan)),
    ],
    ids=["none", "not located", "of the epoch before", "not finite"],
)
def test_without_a_map_to_rely_on_a_node_gets_the_base_alone(
    free_port: int, make_update: MakeUpdate, the_map: MapSnapshot
) -> None:
    update = replace(make_update(2), map=the_map)
    (sample,) = published(free_port, [update], 1, "tf")
    assert transforms(sample) == [("odom", "base_link", update.T_odom_base[0, 3])]


def test_the_bridge_gets_the_same_bytes_under_plain_names(
    free_port: int, make_update: MakeUpdate
) -> None:
    keys = (ODOMETRY_KEY, TF_KEY, "vo/odom", "tf")
    samples = published(free_port, [make_update(1)], 4, *keys)
    payloads = {str(sample.key_expr): sample.payload.to_bytes() for sample in samples}
    assert payloads["vo/odom"] == payloads[ODOMETRY_KEY]
    assert payloads["tf"] == payloads[TF_KEY]


def test_no_transform_goes_out_while_lost(free_port: int, make_update: MakeUpdate) -> None:
    updates = [make_update(0, ok=False), make_update(1)]
    samples = published(free_port, updates, 3, "vo/odom", "tf")
    keys = [str(sample.key_expr) for sample in samples]
    assert sorted(keys) == ["tf", "vo/odom", "vo/odom"]
    message: Any = ROS.deserialize_cdr(
        samples[keys.index("tf")].payload.to_bytes(), "tf2_msgs/msg/TFMessage"
    )
    assert message.transforms[0].transform.translation.x == updates[1].T_odom_base[0, 3]


def test_the_topics_are_listed_until_close(free_port: int) -> None:
    with ros_node(free_port) as node:
        with publishing(free_port, domain_id=7, topic="robot/odom"):
            assert tokens(node, 7, count=3) == {
                ("NN", "kinect_vo"),
                ("MP", f"%robot%odom/{ODOMETRY.dds_name}/{ODOMETRY.hash}/::,10:,:,:,,"),
                ("MP", f"%tf/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}/::,100:,:,:,,"),
            }
        assert tokens(node, 7, count=0) == set()


def test_without_tf_there_is_no_such_topic(free_port: int) -> None:
    with publishing(free_port, tf=False), ros_node(free_port) as node:
        assert {kind for kind, _ in tokens(node, 0, count=2)} == {"NN", "MP"}


def test_a_node_finds_us_beside_the_router_of_its_own(
    free_port: int, make_update: MakeUpdate
) -> None:
    router_port = another_free_port()
    router = session(ROS_ROUTER | {"listen/endpoints": [f"tcp/127.0.0.1:{router_port}"]})
    with router, publishing(free_port) as ours, ros_node(router_port, free_port) as node:
        reader = Reader(node, ODOMETRY_KEY)
        ours.wait_for_readers(ODOMETRY_KEY)
        ours.publish(make_update(0))
        assert len(reader.first(1)) == 1


def test_a_key_that_is_taken_already_is_refused(free_port: int) -> None:
    with (
        pytest.raises(InputError, match="go out under this key already"),
        publishing(free_port, topic="kinect/odom"),
    ):
        pass


def test_nothing_is_declared_unless_asked_for(free_port: int, make_update: MakeUpdate) -> None:
    congestion = zenoh.CongestionControl.DROP
    with open_session(ZenohConfig(listen=(f"tcp/127.0.0.1:{free_port}",))) as ours:
        output = ros2_output(ours, Ros2Settings(), "kinect", FRAMES, congestion)
        output.publish(make_update(0), b"")
        with ros_node(free_port) as node:
            assert tokens(node, 0, count=0) == set()
        output.close()


def tokens(node: zenoh.Session, domain_id: int, count: int) -> set[tuple[str, str]]:
    """Kind and description of what there is in a domain, once there are so many."""
    deadline_s = time.monotonic() + 100
    while True:
        replies: Any = node.liveliness().get(f"@ros2_lv/{domain_id}/**", timeout=60)
        parts = [str(reply.ok.key_expr).split("/") for reply in replies]
        if len(parts) == count:
            return {(each[5], "/".join(each[9:]) or each[8]) for each in parts}
        assert time.monotonic() < deadline_s, parts

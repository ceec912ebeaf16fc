"""A ROS 2 node as Zenoh sees it, and our publisher on a separate session."""

import json
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_typestore

from tests.waiting import wait_until
from vo_service.config_tables import Ros2Config, ZenohConfig
from vo_service.outputs.zenoh.ros2 import ODOMETRY, TF_MESSAGE, Ros2Publisher
from vo_service.outputs.zenoh.session import open_session
from vo_service.types.messages import FrameIds, pose_payload
from vo_service.types.odometry_update import OdometryUpdate

ROS = get_typestore(Stores.ROS2_JAZZY)
FRAMES = FrameIds("odom", "base_link", "map")
ODOMETRY_KEY = f"0/vo/odom/{ODOMETRY.dds_name}/{ODOMETRY.hash}"
TF_KEY = f"0/tf/{TF_MESSAGE.dds_name}/{TF_MESSAGE.hash}"
# As rmw_zenoh opens its sessions and its router; its routers do not forward between peers.
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
def running_session(settings: dict[str, Any]) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as opened:
        yield opened


class RosReader:
    """Subscribes to some keys on a session and waits for samples."""

    def __init__(self, session: zenoh.Session, *keys: str) -> None:
        self.samples: list[zenoh.Sample] = []
        self._changed = threading.Condition()
        for key in keys:
            session.declare_subscriber(key, self._on_sample)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        with self._changed:
            self.samples.append(sample)
            self._changed.notify_all()

    def first(self, count: int) -> list[zenoh.Sample]:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.samples) >= count, 10), len(self.samples)
            return self.samples[:count]


class PublishingService:
    """The publisher on a session of the service."""

    def __init__(self, session: zenoh.Session, settings: Ros2Config) -> None:
        congestion = zenoh.CongestionControl.BLOCK
        self._session = session
        self.publisher = Ros2Publisher(session, settings, "kinect", FRAMES, congestion)

    def publish(self, update: OdometryUpdate) -> None:
        self.publisher.publish(update, pose_payload(update, FRAMES))

    def wait_for_readers(self, *keys: str) -> None:
        """Wait until each of these keys has a subscriber."""
        for key in keys:
            with self._session.declare_publisher(key) as probe:
                wait_until(partial(_has_readers, probe), f"a reader of {key}")


def _has_readers(publisher: zenoh.Publisher) -> bool:
    return bool(publisher.matching_status.matching)  # type: ignore[attr-defined]


@contextmanager
def publishing_service(port: int, **changes: Any) -> Iterator[PublishingService]:
    """Run a publisher on a session as the service opens it."""
    with open_session(ZenohConfig(listen=(f"tcp/127.0.0.1:{port}",))) as ours:
        publishing = PublishingService(ours, Ros2Config(enabled=True, **changes))
        yield publishing
        publishing.publisher.close()


@contextmanager
def ros_node(*connect: int) -> Iterator[zenoh.Session]:
    """Open the session of a ROS 2 node that connects to these ports."""
    endpoints = [f"tcp/127.0.0.1:{port}" for port in connect]
    with running_session(ROS_SESSION | {"connect/endpoints": endpoints}) as opened:
        yield opened


def receive_published(
    port: int, updates: list[OdometryUpdate], count: int, *keys: str, **changes: Any
) -> list[zenoh.Sample]:
    """Publish poses and return the first samples that a node receives on these keys."""
    with publishing_service(port, **changes) as ours, ros_node(port) as node:
        reader = RosReader(node, *keys)
        ours.wait_for_readers(*keys)
        for update in updates:
            ours.publish(update)
        return reader.first(count)


def receive_tokens(node: zenoh.Session, domain_id: int, count: int) -> set[tuple[str, str]]:
    """Return kind and description of a domain's tokens, once there are `count`."""
    deadline_s = time.monotonic() + 100
    while True:
        replies: Any = node.liveliness().get(f"@ros2_lv/{domain_id}/**", timeout=60)
        parts = [str(reply.ok.key_expr).split("/") for reply in replies]
        if len(parts) == count:
            return {(token[5], "/".join(token[9:]) or token[8]) for token in parts}
        assert time.monotonic() < deadline_s, parts

"""Fake service for clients: poses, statuses and the liveliness token over real Zenoh."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from drivers.core.geometry import rigid_transform
from drivers.ros_messages.navigation import (
    OdometryMessage,
    TransformMessage,
    encode_odometry,
    encode_transform,
)
from tests.ports import free_port
from tests.waiting import wait_until
from vo_service import Pose, PoseClient
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.session import open_session

# A busy computer would drop messages, and a test would wait for them in vain.
BLOCK = zenoh.CongestionControl.BLOCK


def find_free_endpoint() -> str:
    """Return an endpoint on a free port of 127.0.0.1."""
    return f"tcp/127.0.0.1:{free_port()}"


class FakeService:
    """Publishes what the test asks for."""

    def __init__(self, endpoint: str) -> None:
        self.endpoint = endpoint
        self.session = open_session(ZenohConfig(listen=(endpoint,)))
        self._odom = self.session.declare_publisher("kinect/odom", congestion_control=BLOCK)
        self._token = self.session.liveliness().declare_token("kinect/alive")

    def wait_for_reader(self, key: str = "kinect/odom") -> None:
        """Wait until there is a subscriber to a key."""
        wait_until(lambda: self.has_reader(key), f"a reader of {key}")

    def has_reader(self, key: str) -> bool:
        """Return whether there is a subscriber to a key."""
        with self.session.declare_publisher(key) as probe:
            return bool(probe.matching_status.matching)  # type: ignore[attr-defined]

    def publish_pose(self, seq: int, x_m: float = 0.0, **attachment: Any) -> None:
        """Publish one pose, `x_m` ahead."""
        T = rigid_transform(np.eye(3), [x_m, 0.5, -0.25])
        message = OdometryMessage(12.5, "odom", "base_link", T, np.eye(6), np.zeros(6), np.eye(6))
        default = {"schema": 1, "seq": seq, "state": "tracking", "epoch": 0, "reason": ""}
        content = json.dumps(default | attachment).encode()
        self._odom.put(encode_odometry(message), attachment=content)

    def publish_map_odom(self, y_m: float = 0.0, **attachment: Any) -> None:
        """Publish a map->odom transform with `y_m` to the left."""
        payload, content = self._map_odom(y_m, attachment)
        self.session.put("kinect/map_odom", payload, attachment=content, congestion_control=BLOCK)

    def answers_map_odom(self, y_m: float = 0.0, **attachment: Any) -> None:
        """Reply to queries with this transform from now on."""
        payload, content = self._map_odom(y_m, attachment)

        def reply(query: zenoh.Query) -> None:
            query.reply("kinect/map_odom", payload, attachment=content)

        self.session.declare_queryable("kinect/map_odom", reply)

    @staticmethod
    def _map_odom(y_m: float, attachment: dict[str, Any]) -> tuple[bytes, bytes]:
        """Make payload and attachment."""
        T = rigid_transform(np.eye(3), [0.0, y_m, 0.0])
        default = {
            "schema": 1, "seq": 0, "epoch": 0, "is_localized": True,
            "map_keyframes": 3, "loop_closures": 1,
        }  # fmt: skip
        payload = encode_transform(TransformMessage(12.5, "map", "odom", T))
        return payload, json.dumps(default | attachment).encode()

    def publish_raw(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Publish any bytes as a pose."""
        self._odom.put(payload, attachment=attachment)

    def publish_status(self, **changes: Any) -> None:
        """Publish one status."""
        default = {"schema": 1, "state": "tracking", "reason": "", "paused": False}
        self.publish_raw_status(json.dumps(default | changes).encode())

    def publish_raw_status(self, payload: bytes) -> None:
        """Publish any bytes as a status."""
        self.session.put("kinect/status", payload, congestion_control=BLOCK)

    def answer_with(self, name: str, answer: dict[str, Any]) -> list[Any]:
        """Reply to queries in this way from now on; return the list of received arguments."""
        received: list[Any] = []

        def reply(query: zenoh.Query) -> None:
            received.append(json.loads(query.payload.to_bytes()) if query.payload else None)
            payload = json.dumps({"schema": 1, **answer}).encode()
            if "error" in answer:
                query.reply_err(payload)
            else:
                query.reply(f"kinect/{name}", payload)

        self.session.declare_queryable(f"kinect/{name}", reply)
        return received

    def close(self) -> None:
        """Close the session."""
        self.session.close()  # type: ignore[no-untyped-call]


@contextmanager
def running_fake_service(endpoint: str = "") -> Iterator[FakeService]:
    """Run a fake service, on a free port by default, while the block runs."""
    service = FakeService(endpoint or find_free_endpoint())
    try:
        yield service
    finally:
        service.close()


def wait_for_pose(client: PoseClient, seq: int) -> None:
    """Wait until the client has received this pose."""

    def has_arrived() -> bool:
        received = client._state.pose.item
        return received is not None and received.attachment.seq == seq

    wait_until(has_arrived)


def publish_and_receive(
    publisher: FakeService, poses: Iterator[Pose], seq: int, **attachment: Any
) -> Pose:
    """Publish a pose and return what a reader gets."""
    publisher.publish_pose(seq, **attachment)
    return next(poses)


def set_reply(
    service: FakeService, client: PoseClient, name: str, reply: dict[str, Any]
) -> list[Any]:
    """Make the service reply in this way, and wait until the client knows that it replies.

    Returns:
        The arguments that it receives.
    """
    received_arguments = service.answer_with(name, reply)
    querier: Any = client._connection.sessions[0].declare_querier(f"kinect/{name}")
    wait_until(lambda: bool(querier.matching_status.matching))
    return received_arguments

"""A service as a client sees it: poses, statuses and the token, sent by hand over real Zenoh."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import zenoh

from drivers.core.geometry import rigid_transform
from tests.ports import free_port
from tests.waiting import wait_until
from vo_service.client import Pose, PoseClient
from vo_service.config_tables import ZenohConfig
from vo_service.outputs.zenoh.cdr_odometry import OdometryMessage, encode_odometry
from vo_service.outputs.zenoh.cdr_transform import TransformMessage, encode_transform
from vo_service.outputs.zenoh.session import open_session


def find_free_endpoint() -> str:
    """On a port of 127.0.0.1 that nobody has."""
    return f"tcp/127.0.0.1:{free_port()}"


class FakeService:
    """Publishes whatever it is told."""

    def __init__(self, endpoint: str) -> None:
        self.session = open_session(ZenohConfig(listen=(endpoint,)))
        self._odom = self.session.declare_publisher("kinect/odom")
        self._token = self.session.liveliness().declare_token("kinect/alive")

    def wait_for_reader(self, key: str = "kinect/odom") -> None:
        """Until somebody has subscribed to this, the poses by default."""
        wait_until(lambda: self.has_reader(key), f"a reader of {key}")

    def has_reader(self, key: str) -> bool:
        """Whether somebody has subscribed to this."""
        with self.session.declare_publisher(key) as probe:
            return bool(probe.matching_status.matching)  # type: ignore[attr-defined]

    def publish_pose(self, seq: int, x_m: float = 0.0, **about: Any) -> None:
        """One pose, `x_m` ahead."""
        T = rigid_transform(np.eye(3), [x_m, 0.5, -0.25])
        message = OdometryMessage(12.5, "odom", "base_link", T, np.eye(6), np.zeros(6), np.eye(6))
        usual = {"schema": 1, "seq": seq, "state": "tracking", "epoch": 0, "reason": ""}
        self._odom.put(encode_odometry(message), attachment=json.dumps(usual | about).encode())

    def publish_map_odom(self, y_m: float = 0.0, **about: Any) -> None:
        """How odom lies in the map: `y_m` to the left."""
        payload, attachment = self._map_odom(y_m, about)
        self.session.put("kinect/map_odom", payload, attachment=attachment)

    def answers_map_odom(self, y_m: float = 0.0, **about: Any) -> None:
        """The same to whoever asks, from now on."""
        payload, attachment = self._map_odom(y_m, about)

        def reply(query: zenoh.Query) -> None:
            query.reply("kinect/map_odom", payload, attachment=attachment)

        self.session.declare_queryable("kinect/map_odom", reply)

    @staticmethod
    def _map_odom(y_m: float, about: dict[str, Any]) -> tuple[bytes, bytes]:
        """Payload and attachment."""
        T = rigid_transform(np.eye(3), [0.0, y_m, 0.0])
        usual = {
            "schema": 1, "seq": 0, "epoch": 0, "is_localized": True, "map_keyframes": 3, "loop_closures": 1,
        }  # fmt: skip
        payload = encode_transform(TransformMessage(12.5, "map", "odom", T))
        return payload, json.dumps(usual | about).encode()

    def publish_raw(self, payload: bytes, attachment: bytes | None = None) -> None:
        """Whatever comes."""
        self._odom.put(payload, attachment=attachment)

    def publish_status(self, **changes: Any) -> None:
        """One status."""
        usual = {"schema": 1, "state": "tracking", "reason": "", "paused": False}
        self.session.put("kinect/status", json.dumps(usual | changes).encode())

    def answer_with(self, name: str, answer: dict[str, Any]) -> list[Any]:
        """Answer a question in this way from now on; the arguments that came."""
        heard: list[Any] = []

        def reply(query: zenoh.Query) -> None:
            heard.append(json.loads(query.payload.to_bytes()) if query.payload else None)
            payload = json.dumps({"schema": 1, **answer}).encode()
            if "error" in answer:
                query.reply_err(payload)
            else:
                query.reply(f"kinect/{name}", payload)

        self.session.declare_queryable(f"kinect/{name}", reply)
        return heard

    def close(self) -> None:
        """Gone."""
        self.session.close()  # type: ignore[no-untyped-call]


@contextmanager
def running_fake_service(endpoint: str) -> Iterator[FakeService]:
    """A service that goes at the end of the block."""
    it = FakeService(endpoint)
    try:
        yield it
    finally:
        it.close()


ServiceAndClient = tuple[FakeService, PoseClient]


def wait_for_pose(client: PoseClient, seq: int) -> None:
    """Until this pose has come."""

    def is_there() -> bool:
        found = client._state.pose.item
        return found is not None and found.attachment["seq"] == seq

    wait_until(is_there)


def publish_and_receive(
    publisher: FakeService, poses: Iterator[Pose], seq: int, **about: Any
) -> Pose:
    """What a reader gets once this is published."""
    publisher.publish_pose(seq, **about)
    return next(poses)

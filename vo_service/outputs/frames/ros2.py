"""Frames for ROS 2: the keys of their topics, and the tokens by which nodes discover them."""

import time
from collections.abc import Callable
from typing import TypeVar

import zenoh

from drivers.core.geometry import Array
from drivers.ros_messages.navigation import TransformMessage
from vo_service.config_tables import Ros2Config
from vo_service.outputs.zenoh.ros2 import (
    LatchedPublisher,
    RosNode,
    RosTopic,
    encode_attachment,
    node_name,
    publish_static_transform,
    publisher_gid,
    ros_type,
)

# Numbers of the publishers in the ROS node; those of the poses and of /tf come before.
FIRST_NUMBER = 10
DEPTH = 1

Publisher = TypeVar("Publisher")
# Declares a key, whose attachments the second argument makes of the frame's own ones.
KeyDeclaration = Callable[[str, Callable[[bytes], bytes]], Publisher]


class RosFrames:
    """The frames' topics for ROS 2 on one session.

    Args:
        prefix: Prefix of the frames' own keys, which is part of the node's name.
        ros2: Domain, namespace, and whether to publish transforms.
    """

    def __init__(self, session: zenoh.Session, prefix: str, ros2: Ros2Config) -> None:
        self._session, self._ros2 = session, ros2
        self._node = RosNode(ros2.domain_id, str(session.zid()), node_name(prefix))
        self._next_number = FIRST_NUMBER
        self._tokens: list[zenoh.LivelinessToken] = []
        self._transforms: list[LatchedPublisher] = []

    def declare_topic(
        self, name: str, schema: str, declare_key: KeyDeclaration[Publisher]
    ) -> list[Publisher]:
        """Declare the keys of a topic, and its token; nothing if it is not for ROS.

        Args:
            name: The topic below the namespace, or with a first slash; "" = it is not for ROS.
        """
        number = self._take_number()
        if not name:
            return []
        path = name[1:] if name.startswith("/") else f"{self._ros2.namespace}/{name}"
        topic = RosTopic(path, ros_type(schema), DEPTH)
        token = self._node.publisher_token(number, topic)
        publishers = [
            declare_key(topic.bridge_key, lambda own: own),
            declare_key(topic.rmw_key(self._node.domain_id), _NumberedAttachments(token)),
        ]
        self._tokens.append(self._session.liveliness().declare_token(token))
        return publishers

    def declare_transform(self, frame_id: str, child_frame_id: str, T_frame_child: Array) -> None:
        """Publish a fixed transform on /tf_static, if transforms are enabled.

        Args:
            T_frame_child: 4x4, meters.
        """
        if not self._ros2.tf:
            return
        transform = TransformMessage(time.time(), frame_id, child_frame_id, T_frame_child)
        self._transforms.append(
            publish_static_transform(self._session, self._node, self._take_number(), transform)
        )

    def _take_number(self) -> int:
        self._next_number += 1
        return self._next_number - 1


class _NumberedAttachments:
    """Makes the attachments that rmw_zenoh expects: the samples are numbered from 1."""

    def __init__(self, token: str) -> None:
        self._gid = publisher_gid(token)
        self._count = 0

    def __call__(self, _own: bytes) -> bytes:
        self._count += 1
        return encode_attachment(self._count, time.time_ns(), self._gid)

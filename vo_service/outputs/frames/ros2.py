"""Frames for ROS 2: the keys of their topics, and the tokens by which nodes discover them."""

import time

import zenoh

from vo_service.outputs.frames import (
    AttachmentMaker,
    FrameKeyPublisher,
    FrameOutputConfig,
    FrameTopic,
)
from vo_service.outputs.zenoh.ros2 import (
    RosNode,
    RosTopic,
    StaticTransformPublisher,
    encode_attachment,
    node_name,
    publisher_gid,
    ros_type,
)
from vo_service.ros_messages import TransformMessage

# Numbers of the publishers in the ROS node; those of the poses and of /tf come before.
FIRST_NUMBER = 10
DEPTH = 1


class RosFrames:
    """Publishers of the frames for ROS 2 on one session."""

    def __init__(self, session: zenoh.Session, config: FrameOutputConfig) -> None:
        self._session, self._config = session, config
        self._node = RosNode(config.ros2.domain_id, str(session.zid()), node_name(config.prefix))
        self._next_number = FIRST_NUMBER
        self._tokens: list[zenoh.LivelinessToken] = []
        self._transforms: list[StaticTransformPublisher] = []

    def declare_topic(self, topic: FrameTopic) -> list[FrameKeyPublisher]:
        """Declare the keys of a topic, and its token; nothing if it is not for ROS."""
        number = self._take_number()
        if not topic.ros_name:
            return []
        name = f"{self._config.ros2.namespace}/{topic.ros_name}"
        ros_topic = RosTopic(name, ros_type(topic.schema), DEPTH)
        token = self._node.publisher_token(number, ros_topic)
        publishers = [
            self._publisher(ros_topic.bridge_key, lambda own: own),
            self._publisher(ros_topic.rmw_key(self._node.domain_id), _NumberedAttachments(token)),
        ]
        self._tokens.append(self._session.liveliness().declare_token(token))
        return publishers

    def declare_transform(self) -> None:
        """Publish the camera's pose in the base on /tf_static, if it is enabled."""
        if not self._config.ros2.tf:
            return
        config = self._config
        transform = TransformMessage(
            time.time(), config.base_frame_id, config.frames.frame_id, config.T_base_camera
        )
        self._transforms.append(
            StaticTransformPublisher(self._session, self._node, self._take_number(), transform)
        )

    def _publisher(self, key: str, make_attachment: AttachmentMaker) -> FrameKeyPublisher:
        encoding = zenoh.Encoding.APPLICATION_CDR
        return FrameKeyPublisher(self._session, key, encoding, make_attachment)

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

"""The publishers of one frame topic: its own key and, for ROS 2, those of the two bridges."""

import time
from collections.abc import Callable, Sequence

import zenoh

from vo_service.outputs.frames.shared_memory import SharedPayloads
from vo_service.outputs.frames.topics import FrameTopic
from vo_service.outputs.zenoh.ros2 import RosNode, RosTopic, encode_attachment, publisher_gid
from vo_service.types import OdometryUpdate

# Makes the attachment of a sample from the frame's own one.
AttachmentMaker = Callable[[bytes], bytes]


class FrameKeyPublisher:
    """Publisher of one key that knows whether somebody subscribes.

    Frames give way to everything else on a link, and a reader that is too slow loses them.
    """

    def __init__(
        self,
        session: zenoh.Session,
        key: str,
        encoding: zenoh.Encoding,
        make_attachment: AttachmentMaker,
    ) -> None:
        self.is_wanted = False
        self._make_attachment = make_attachment
        self._publisher = session.declare_publisher(
            key,
            encoding=encoding,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
        )
        self._listener = self._publisher.declare_matching_listener(self._on_match)

    def put(self, payload: zenoh.ZBytes, attachment: bytes) -> None:
        """Publish one sample."""
        self._publisher.put(payload, attachment=self._make_attachment(attachment))

    def _on_match(self, status: zenoh.MatchingStatus) -> None:
        self.is_wanted = status.matching


class FrameTopicPublisher:
    """Encodes one topic once for all its keys, if any of them is wanted."""

    def __init__(self, topic: FrameTopic, keys: Sequence[FrameKeyPublisher]) -> None:
        self._topic = topic
        self._keys = keys

    @property
    def is_wanted(self) -> bool:
        """Whether somebody subscribes."""
        return any(key.is_wanted for key in self._keys)

    def publish(
        self, update: OdometryUpdate, attachment: bytes, shared_payloads: SharedPayloads
    ) -> None:
        """Encode and publish the topic of a frame. Raises ValueError, ZError."""
        keys = [key for key in self._keys if key.is_wanted]
        for payload in self._topic.encode(update) if keys else ():
            shared = shared_payloads.share(payload)
            for key in keys:
                key.put(shared, attachment)


def plain_key(session: zenoh.Session, topic: FrameTopic, prefix: str) -> FrameKeyPublisher:
    """Declare the topic's own key."""
    encoding = (
        zenoh.Encoding.APPLICATION_CDR.with_schema(topic.schema)
        if topic.schema
        else zenoh.Encoding.APPLICATION_JSON
    )
    return FrameKeyPublisher(session, f"{prefix}/{topic.name}", encoding, lambda own: own)


class RosKeys:
    """The keys of a topic for ROS 2, and the token by which nodes discover it."""

    def __init__(self, session: zenoh.Session, node: RosNode, number: int, topic: RosTopic) -> None:
        token = node.publisher_token(number, topic)
        self._gid = publisher_gid(token)
        self._count = 0
        encoding = zenoh.Encoding.APPLICATION_CDR
        self.publishers = [
            FrameKeyPublisher(session, topic.bridge_key, encoding, lambda own: own),
            FrameKeyPublisher(session, topic.rmw_key(node.domain_id), encoding, self._attachment),
        ]
        self._token = session.liveliness().declare_token(token)

    def _attachment(self, own: bytes) -> bytes:
        self._count += 1
        return encode_attachment(self._count, time.time_ns(), self._gid)

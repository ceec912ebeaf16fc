"""Publishers of topics: they encode and send only what is wanted."""

import logging
from collections.abc import Callable, Sequence

import zenoh
import zenoh.shm

from vo_service.outputs.frames.shared_payloads import SharedPayloads
from vo_service.outputs.frames.topics import FrameTopic
from vo_service.types.odometry_update import OdometryUpdate

logger = logging.getLogger(__name__)


# Makes the attachment of a sample from the frame's own one.
AttachmentMaker = Callable[[bytes], bytes]


class FrameKeyPublisher:
    """Publisher of one key that knows whether somebody subscribes.

    Frames give way to everything else on a link, and a reader that is too slow loses them.
    """

    def __init__(
        self,
        session: zenoh.Session,
        encoding: zenoh.Encoding,
        key: str,
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
        """Encode and publish the topic of a frame.

        Args:
            shared_payloads: Puts a message into shared memory, once for all keys.

        Raises:
            ValueError: The frame cannot be encoded.
            zenoh.ZError: Publishing fails.
        """
        keys = [key for key in self._keys if key.is_wanted]
        for payload in self._topic.encode(update) if keys else ():
            shared = shared_payloads.share(payload)
            for key in keys:
                key.put(shared, attachment)

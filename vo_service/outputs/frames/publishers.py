"""The publisher of a topic: it encodes and sends only what is wanted."""

import zenoh
import zenoh.shm

from vo_service.outputs.frames.shared_payloads import SharedPayloads
from vo_service.outputs.frames.topics import FrameTopic
from vo_service.types.odometry_update import OdometryUpdate


class FrameTopicPublisher:
    """Encodes and publishes one topic while somebody subscribes.

    Frames give way to everything else on a link, and a reader that is too slow loses them.
    """

    def __init__(self, session: zenoh.Session, prefix: str, topic: FrameTopic) -> None:
        self.is_wanted = False
        self._topic = topic
        cdr = zenoh.Encoding.APPLICATION_CDR
        self._publisher = session.declare_publisher(
            f"{prefix}/{topic.name}",
            encoding=(
                cdr.with_schema(topic.schema) if topic.schema else zenoh.Encoding.APPLICATION_JSON
            ),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND,
        )
        self._listener = self._publisher.declare_matching_listener(self._on_match)

    def _on_match(self, status: zenoh.MatchingStatus) -> None:
        self.is_wanted = status.matching

    def publish(
        self, update: OdometryUpdate, attachment: bytes, shared_payloads: SharedPayloads
    ) -> None:
        """Encode and publish the topic of a frame.

        Args:
            shared_payloads: Puts a message into shared memory.

        Raises:
            ValueError: The frame cannot be encoded.
            zenoh.ZError: Publishing fails.
        """
        for payload in self._topic.encode(update) if self.is_wanted else ():
            self._publisher.put(shared_payloads.share(payload), attachment=attachment)

"""Topics that are passed on from kinect-vo to ROS."""

import json
from collections.abc import Callable
from typing import Any

import zenoh
import zenoh.ext
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from kinect_vo_ros2.publishing_thread import PublishingThread
from kinect_vo_ros2.settings import NodeSettings
from kinect_vo_ros2.topics import Topic
from kinect_vo_ros2.transforms import Transform, encode_transforms, read_transform, stamp_of

# What waits if ROS is slow: a third of a second of poses, two frames.
_POSES, _FRAMES = 10, 2
# Encapsulation and stamp of a message with a header: a rosgraph_msgs/Clock.
_CLOCK = slice(0, 12)

TransformMessage = Any  # the class tf2_msgs.msg.TFMessage


class TopicRelay:
    """Publishes what is received on a key as it is, on a thread of its own."""

    def __init__(self, node: Node, prefix: str, topic: Topic, qos: QoSProfile) -> None:
        self._key = f"{prefix}/{topic.key}"
        self._publisher: Publisher = node.create_publisher(topic.message, topic.name, qos)
        self._thread = PublishingThread(topic.key, self._publish, _FRAMES, _error_logger(node))

    def close(self) -> None:
        """Stop publishing."""
        self._thread.close()

    def _publish(self, sample: zenoh.Sample) -> None:
        self._publisher.publish(sample.payload.to_bytes())


class OnDemandRelay(TopicRelay):
    """Passes a topic on while somebody in ROS subscribes to it."""

    def __init__(self, node: Node, prefix: str, topic: Topic) -> None:
        # Reliable, which serves readers of both kinds.
        super().__init__(node, prefix, topic, QoSProfile(depth=5))
        self._subscriber: zenoh.Subscriber[None] | None = None

    def update(self, session: zenoh.Session) -> None:
        """Subscribe to kinect-vo if somebody subscribes in ROS, else unsubscribe; call it often."""
        is_wanted = self._publisher.get_subscription_count() > 0
        if is_wanted and self._subscriber is None:
            self._subscriber = session.declare_subscriber(self._key, self._thread.put)
        elif not is_wanted and self._subscriber is not None:
            self._subscriber.undeclare()  # type: ignore[no-untyped-call]
            self._subscriber = None


class LatchedRelay(TopicRelay):
    """Passes on a topic whose last message is kept for those who come later."""

    def __init__(self, node: Node, prefix: str, topic: Topic) -> None:
        qos = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        super().__init__(node, prefix, topic, qos)
        self._subscriber: zenoh.ext.AdvancedSubscriber[None] | None = None

    def declare(self, session: zenoh.Session) -> None:
        """Subscribe on a new session."""
        self._subscriber = zenoh.ext.declare_advanced_subscriber(
            session,
            self._key,
            self._thread.put,
            history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
        )


class PoseRelay:
    """Passes poses on as odom, and makes /tf and /clock of them.

    /tf has odom to base and, if the map is known, map to odom with the same stamp. While a pose is
    lost there is no transform: a lookup fails instead of returning a wrong pose.

    Args:
        node: The node.
        settings: Prefix, and whether to publish /tf and /clock.
        transform_message: Class of tf2_msgs/TFMessage; None: no transforms.
    """

    def __init__(
        self, node: Node, settings: NodeSettings, transform_message: TransformMessage | None
    ) -> None:
        self._prefix = settings.prefix
        self._odom = node.create_publisher(Odometry, "odom", QoSProfile(depth=10))
        self._clock = self._tf = None
        if settings.publish_clock:
            self._clock = node.create_publisher(Clock, "/clock", QoSProfile(depth=1))
        if settings.publish_tf and transform_message is not None:
            self._tf = node.create_publisher(transform_message, "/tf", QoSProfile(depth=100))
        self._thread = PublishingThread("poses", self._publish, _POSES, _error_logger(node))
        self._map_odom: tuple[Transform, int] | None = None  # and its epoch
        self._frame_ids = ("", "")

    def declare(self, session: zenoh.Session) -> None:
        """Subscribe on a new session."""
        session.declare_subscriber(f"{self._prefix}/odom", self._thread.put)
        session.declare_subscriber(f"{self._prefix}/map_odom", self._on_map_odom)

    def close(self) -> None:
        """Stop publishing."""
        self._thread.close()

    def get_frame_ids(self) -> tuple[str, str]:
        """Return the names of the frames odom and base; "" if not known yet."""
        return self._frame_ids

    def _on_map_odom(self, sample: zenoh.Sample) -> None:
        attachment = _attachment(sample)
        transform = read_transform(sample.payload.to_bytes())
        is_known = attachment.get("is_localized") is True
        self._map_odom = (transform, attachment["epoch"]) if is_known else None

    def _publish(self, sample: zenoh.Sample) -> None:
        message = sample.payload.to_bytes()
        self._odom.publish(message)
        if self._clock is not None:
            self._clock.publish(message[_CLOCK])
        attachment, odom_base = _attachment(sample), read_transform(message)
        self._frame_ids = (odom_base.frame_id.decode(), odom_base.child_frame_id.decode())
        if self._tf is None or attachment.get("state") == "lost":
            return
        transforms = [odom_base]
        if (known := self._map_odom) and known[1] == attachment.get("epoch"):
            transforms.append(known[0].at(stamp_of(message)))
        self._tf.publish(encode_transforms(transforms))


def _attachment(sample: zenoh.Sample) -> dict[str, Any]:
    content = json.loads(sample.attachment.to_bytes()) if sample.attachment else {}
    return content if isinstance(content, dict) else {}


def _error_logger(node: Node) -> Callable[[Exception], None]:
    """Make a function that logs errors, at most one a minute."""

    def log(error: Exception) -> None:
        if node.context.ok():
            node.get_logger().error(
                f"a message is not published: {error}", throttle_duration_sec=60.0
            )

    return log

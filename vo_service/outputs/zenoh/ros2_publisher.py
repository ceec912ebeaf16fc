"""The poses once more, as a ROS 2 node would publish them. Experimental: never met a real node."""

import time
from collections.abc import Iterator
from typing import Protocol

import numpy as np
import zenoh

from drivers.core.errors import InputError
from vo_service.config_tables import Ros2Config
from vo_service.outputs.zenoh.cdr_transform import TransformMessage, encode_transforms
from vo_service.outputs.zenoh.messages import FrameIds, map_odom_transform
from vo_service.outputs.zenoh.ros2_names import (
    ODOMETRY,
    TF_MESSAGE,
    RosNode,
    RosTopic,
    encode_attachment,
    node_name,
    publisher_gid,
)
from vo_service.types import NO_MAP, OdometryUpdate, TrackingState

# What rclcpp and tf2_ros ask for.
ODOMETRY_DEPTH, TF_DEPTH = 10, 100


class Ros2Output(Protocol):
    """Somewhere that ROS 2 nodes read."""

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """Publish one pose; `odometry` is its CDR. Raises ValueError if it is not finite."""
        ...

    def close(self) -> None:
        """Be gone from the list of topics."""
        ...


class NullRos2Output:
    """Where nobody asked for it."""

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class Ros2Publisher:
    """Publishes on an open session, for zenoh-bridge-ros2dds and for rmw_zenoh at once.

    topic  nav_msgs/msg/Odometry, the same bytes as on `{prefix}/odom`
    /tf    tf2_msgs/msg/TFMessage, unless switched off: the base in `odom` and, where there is a
           map, `odom` in it, stamped alike. Not while lost, and `odom` not before it is known
           where it lies: a transform has no field for doubt, and who asks for one that is not
           there is told so

    Raises InputError for a topic's name that ROS 2 would not take, or that is `{prefix}/odom`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        settings: Ros2Config,
        prefix: str,
        frame_ids: FrameIds,
        congestion: zenoh.CongestionControl,
    ) -> None:
        self._frame_ids = frame_ids
        if settings.topic == f"{prefix}/odom":
            raise InputError(
                f"ros2.topic = {settings.topic!r}: the poses go out under this key already; "
                "use another name"
            )
        odometry = RosTopic(settings.topic, ODOMETRY, ODOMETRY_DEPTH)
        node = RosNode(settings.domain_id, str(session.zid()), node_name(prefix))
        self._node = session.liveliness().declare_token(node.liveliness_token)
        self._odometry = _TopicPublisher(session, node, 1, odometry, congestion)
        self._tf = (
            [_TopicPublisher(session, node, 2, RosTopic("tf", TF_MESSAGE, TF_DEPTH), congestion)]
            if settings.tf
            else []
        )

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """See `Ros2Output`."""
        source_ns = time.time_ns()
        self._odometry.put(odometry, source_ns)
        if update.state is TrackingState.LOST:
            return
        for tf in self._tf:
            tf.put(encode_transforms(list(self._transforms(update))), source_ns)

    def _transforms(self, update: OdometryUpdate) -> Iterator[TransformMessage]:
        frames = self._frame_ids
        yield TransformMessage(
            update.stamp_s, frames.frame_id, frames.child_frame_id, update.T_odom_base
        )
        if _is_map_odom_known(update):
            yield map_odom_transform(update, frames)

    def close(self) -> None:
        """See `Ros2Output`."""
        for publisher in (self._odometry, *self._tf):
            publisher.close()
        self._node.undeclare()  # type: ignore[no-untyped-call]


def _is_map_odom_known(update: OdometryUpdate) -> bool:
    """Whether `odom` does. What is wrong with a map must not keep the base's own transform back."""
    is_known = update.map is not NO_MAP and update.is_localized
    return is_known and bool(np.all(np.isfinite(update.map.T_map_odom)))


class _TopicPublisher:
    """One topic, under the key of either way; its samples are numbered from 1."""

    def __init__(
        self,
        session: zenoh.Session,
        node: RosNode,
        number: int,
        topic: RosTopic,
        congestion: zenoh.CongestionControl,
    ) -> None:
        self._bridge, self._rmw = (
            session.declare_publisher(
                key,
                congestion_control=congestion,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
                reliability=zenoh.Reliability.RELIABLE,
            )
            for key in (topic.bridge_key, topic.rmw_key(node.domain_id))
        )
        token = node.publisher_token(number, topic)
        self._gid = publisher_gid(token)
        self._token = session.liveliness().declare_token(token)
        self._count = 0

    def put(self, payload: bytes, source_ns: int) -> None:
        """Publish one sample."""
        self._count += 1
        self._bridge.put(payload)
        self._rmw.put(payload, attachment=encode_attachment(self._count, source_ns, self._gid))

    def close(self) -> None:
        """Take back what was declared."""
        self._token.undeclare()  # type: ignore[no-untyped-call]
        for publisher in (self._bridge, self._rmw):
            publisher.undeclare()  # type: ignore[no-untyped-call]


def make_ros2_output(
    session: zenoh.Session,
    settings: Ros2Config,
    prefix: str,
    frame_ids: FrameIds,
    congestion: zenoh.CongestionControl,
) -> Ros2Output:
    """What the settings ask for."""
    if not settings.enabled:
        return NullRos2Output()
    return Ros2Publisher(session, settings, prefix, frame_ids, congestion)

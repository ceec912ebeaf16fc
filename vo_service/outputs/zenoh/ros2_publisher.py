"""Publisher of the poses for ROS 2. Experimental: not tested with a real node."""

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

# QoS depths that rclcpp and tf2_ros request.
ODOMETRY_DEPTH, TF_DEPTH = 10, 100


class Ros2Output(Protocol):
    """Output to ROS 2 nodes."""

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """Publish one pose; `odometry` is its CDR. Raises ValueError if it is not finite."""
        ...

    def close(self) -> None:
        """Withdraw the publishers."""
        ...


class NullRos2Output:
    """Output that publishes nothing."""

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""


class Ros2Publisher:
    """Publishes on an open session, for zenoh-bridge-ros2dds and for rmw_zenoh at once.

    - the configured topic: nav_msgs/msg/Odometry, the same bytes as on `{prefix}/odom`
    - /tf, if enabled: tf2_msgs/msg/TFMessage with odom->base and, if there is a map, map->odom.
      While lost, neither is published; before localization, map->odom is not. A transform has no
      covariance, so an uncertain one must be absent.

    Raises:
        InputError: the topic's name is not valid in ROS 2, or is `{prefix}/odom`.
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
                f"ros2.topic = {settings.topic!r}: the poses already use this key; give another "
                "name"
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
        """Publish one pose; `odometry` is its CDR. Raises ValueError if it is not finite."""
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
        """Withdraw the publishers."""
        for publisher in (self._odometry, *self._tf):
            publisher.close()
        self._node.undeclare()  # type: ignore[no-untyped-call]


def _is_map_odom_known(update: OdometryUpdate) -> bool:
    """Return whether map->odom is known and finite: a bad map must not block odom->base."""
    is_known = update.map is not NO_MAP and update.is_localized
    return is_known and bool(np.all(np.isfinite(update.map.T_map_odom)))


class _TopicPublisher:
    """Publisher of one topic on both keys; its samples are numbered from 1."""

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
        """Undeclare everything."""
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
    """Make the configured ROS 2 output. Raises as `Ros2Publisher`."""
    if not settings.enabled:
        return NullRos2Output()
    return Ros2Publisher(session, settings, prefix, frame_ids, congestion)

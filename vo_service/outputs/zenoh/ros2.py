"""Zenoh keys, liveliness tokens and attachments of ROS 2's two Zenoh bridges.

zenoh-bridge-ros2dds uses the topic's name as the key. rmw_zenoh (Jazzy and later) adds the type and
its hash (REP 2011) to the key and an attachment of 33 bytes to each sample. Its nodes discover
publishers by liveliness tokens (its docs/design.md, "Graph Cache" and "Publishers").
"""

import hashlib
import re
import struct
import time
from dataclasses import dataclass

import zenoh

from drivers.core import InputError
from drivers.ros_messages.navigation import (
    OCCUPANCY_GRID_SCHEMA,
    ODOMETRY_SCHEMA,
    TRANSFORMS_SCHEMA,
    TransformMessage,
    encode_transforms,
)
from drivers.ros_messages.sensors import (
    CAMERA_INFO_SCHEMA,
    COMPRESSED_IMAGE_SCHEMA,
    IMAGE_SCHEMA,
    IMU_SCHEMA,
    LASER_SCAN_SCHEMA,
    POINT_CLOUD_SCHEMA,
)
from vo_service.config_tables import Ros2Config
from vo_service.outputs.zenoh.session import declare_latched_publisher
from vo_service.types.messages import FrameIds, pose_transforms
from vo_service.types.odometry_update import OdometryUpdate

# Stands for the empty enclave and namespace: a key may have no empty part.
_EMPTY_PART = "%"
_GID_BYTES = 16
# Sequence number, source time in ns, and the length of the gid that follows, little endian.
_ATTACHMENT = struct.Struct("<qqB")
# QoS depths that rclcpp and tf2_ros request.
ODOMETRY_DEPTH, TF_DEPTH = 10, 100


@dataclass(frozen=True)
class RosType:
    """A message type as rmw_zenoh writes it: DDS name and version-1 hash."""

    dds_name: str
    hash: str


_HASHES = {
    ODOMETRY_SCHEMA: "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    TRANSFORMS_SCHEMA: "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    IMAGE_SCHEMA: "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    COMPRESSED_IMAGE_SCHEMA: "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a",
    CAMERA_INFO_SCHEMA: "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    POINT_CLOUD_SCHEMA: "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    IMU_SCHEMA: "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    LASER_SCAN_SCHEMA: "64c191398013af96509d518dac71d5164f9382553fce5c1f8cca5be7924bd828",
    OCCUPANCY_GRID_SCHEMA: "8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7",
}


def ros_type(schema: str) -> RosType:
    """Return the type of a message, such as sensor_msgs/msg/Image."""
    package, _, name = schema.split("/")
    return RosType(f"{package}::msg::dds_::{name}_", f"RIHS01_{_HASHES[schema]}")


ODOMETRY = ros_type(ODOMETRY_SCHEMA)
TF_MESSAGE = ros_type(TRANSFORMS_SCHEMA)


@dataclass(frozen=True)
class RosTopic:
    """A published topic.

    Attributes:
        name: Name without the first slash.
        type: Message type.
        depth: QoS depth.
        is_latched: Whether a node that subscribes later gets the last message: transient local.

    Raises:
        InputError: The name is not valid in ROS 2.
    """

    name: str
    type: RosType
    depth: int
    is_latched: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", self.name):
            raise InputError(
                f"ros2.topic = {self.name!r}: use names of letters, digits and '_' that do not "
                "begin with a digit, separated by single slashes, such as vo/odom"
            )

    @property
    def bridge_key(self) -> str:
        """Key of zenoh-bridge-ros2dds."""
        return self.name

    def rmw_key(self, domain_id: int) -> str:
        """Key of rmw_zenoh."""
        return f"{domain_id}/{self.name}/{self.type.dds_name}/{self.type.hash}"


@dataclass(frozen=True)
class RosNode:
    """The service's ROS node on one Zenoh session.

    Attributes:
        domain_id: ROS domain.
        zid: The session's Zenoh id.
        name: Letters, digits and '_'.
    """

    domain_id: int
    zid: str
    name: str

    @property
    def liveliness_token(self) -> str:
        """Key of the node's liveliness token."""
        return self._liveliness_key(0, "NN")

    def publisher_token(self, number: int, topic: RosTopic) -> str:
        """Return the key of a publisher's liveliness token.

        Its QoS is reliable, keep last `depth`; empty fields have ROS's defaults.

        Args:
            number: Unique number of the publisher in this node.
        """
        topic_name = "/" + topic.name
        parts = (_mangle(topic_name), topic.type.dds_name, topic.type.hash)
        qos = f":{'1' if topic.is_latched else ''}:,{topic.depth}:,:,:,,"
        return "/".join((self._liveliness_key(number, "MP"), *parts, qos))

    def _liveliness_key(self, number: int, kind: str) -> str:
        key_prefix = f"@ros2_lv/{self.domain_id}/{self.zid}/0/{number}"
        return f"{key_prefix}/{kind}/{_EMPTY_PART}/{_EMPTY_PART}/{self.name}"


def node_name(prefix: str) -> str:
    """Return the node's name for a Zenoh prefix: kinect_vo for kinect."""
    name = re.sub(r"\W", "_", prefix, flags=re.ASCII) + "_vo"
    return f"_{name}" if name[0].isdecimal() else name


def publisher_gid(token: str) -> bytes:
    """Return 16 bytes that identify the publisher, so that readers can count lost samples.

    rmw_zenoh uses another hash of the same token (XXH3); nothing compares the two.
    """
    return hashlib.blake2b(token.encode(), digest_size=_GID_BYTES).digest()


def encode_attachment(sequence_number: int, source_ns: int, gid: bytes) -> bytes:
    """Encode a sample's attachment.

    Args:
        sequence_number: Number of the sample, from 1.
        source_ns: Unix time, nanoseconds.
        gid: 16 bytes from `publisher_gid`.
    """
    return _ATTACHMENT.pack(sequence_number, source_ns, _GID_BYTES) + gid


def _mangle(name: str) -> str:
    return name.replace("/", _EMPTY_PART)


class Ros2Publisher:
    """Publishes on an open session, for zenoh-bridge-ros2dds and for rmw_zenoh at once.

    - the configured topic: nav_msgs/msg/Odometry, the same bytes as on `{prefix}/odom`
    - /tf, if enabled: tf2_msgs/msg/TFMessage with odom->base and, if there is a map, map->odom; see
      `pose_transforms`
    - /map, once there is one, latched: nav_msgs/msg/OccupancyGrid, as on `{prefix}/map`

    Raises:
        InputError: The topic's name is not valid in ROS 2, or is `{prefix}/odom`.
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
        self._session, self._ros_node = session, node
        self._map: LatchedPublisher | None = None  # another node may publish the topic
        self._tf = (
            [_TopicPublisher(session, node, 2, RosTopic("tf", TF_MESSAGE, TF_DEPTH), congestion)]
            if settings.tf
            else []
        )

    def publish(self, update: OdometryUpdate, odometry: bytes) -> None:
        """Publish one pose; `odometry` is its CDR.

        Raises:
            ValueError: If it is not finite.
        """
        source_ns = time.time_ns()
        self._odometry.put(odometry, source_ns)
        transforms = pose_transforms(update, self._frame_ids)
        for tf in self._tf if transforms else ():
            tf.put(encode_transforms(transforms), source_ns)

    def publish_grid(self, payload: bytes) -> None:
        """Publish the occupancy grid; `payload` is its CDR."""
        if self._map is None:
            kind = ros_type(OCCUPANCY_GRID_SCHEMA)
            self._map = LatchedPublisher(self._session, self._ros_node, 3, "map", kind)
        self._map.put(payload)

    def close(self) -> None:
        """Withdraw the publishers."""
        for publisher in (self._odometry, *self._tf):
            publisher.close()
        self._node.undeclare()  # type: ignore[no-untyped-call]


class LatchedPublisher:
    """Publishes a topic whose last message also reaches nodes that subscribe later.

    For rmw_zenoh the publisher keeps the message; for the bridge it is sent again to each new
    subscriber.
    """

    def __init__(
        self, session: zenoh.Session, node: RosNode, number: int, name: str, kind: RosType
    ) -> None:
        topic = RosTopic(name, kind, depth=1, is_latched=True)
        self._payload = b""
        self._count = 0
        token = node.publisher_token(number, topic)
        self._gid = publisher_gid(token)
        # rmw_zenoh's own publishers of latched topics are of this kind.
        self._rmw = declare_latched_publisher(session, topic.rmw_key(node.domain_id))
        self._bridge = session.declare_publisher(topic.bridge_key)
        self._listener = self._bridge.declare_matching_listener(self._on_match)
        self._token = session.liveliness().declare_token(token)

    def put(self, payload: bytes) -> None:
        """Publish a message."""
        self._payload, self._count = payload, self._count + 1
        attachment = encode_attachment(self._count, time.time_ns(), self._gid)
        self._rmw.put(payload, attachment=attachment)
        self._bridge.put(payload)

    def _on_match(self, status: zenoh.MatchingStatus) -> None:
        if status.matching and self._payload:
            self._bridge.put(self._payload)


def publish_static_transform(
    session: zenoh.Session, node: RosNode, number: int, transform: TransformMessage
) -> LatchedPublisher:
    """Publish one transform on /tf_static; return its publisher, which has to be kept."""
    publisher = LatchedPublisher(session, node, number, "tf_static", TF_MESSAGE)
    publisher.put(encode_transforms([transform]))
    return publisher


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

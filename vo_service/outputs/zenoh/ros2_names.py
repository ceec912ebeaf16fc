"""Zenoh keys, liveliness tokens and attachments of ROS 2's two Zenoh bridges.

zenoh-bridge-ros2dds uses the topic's name as the key. rmw_zenoh (Jazzy and later) adds the type and
its hash (REP 2011) to the key and an attachment of 33 bytes to each sample. Its nodes discover
publishers by liveliness tokens (its docs/design.md, "Graph Cache" and "Publishers").
"""

import hashlib
import re
import struct
from dataclasses import dataclass

from drivers.core.errors import InputError

# Stands for the empty enclave and namespace: a key may have no empty part.
_EMPTY_PART = "%"
_GID_BYTES = 16
# Sequence number, source time in ns, and the length of the gid that follows, little endian.
_ATTACHMENT = struct.Struct("<qqB")


@dataclass(frozen=True)
class RosType:
    """A message type as rmw_zenoh writes it: DDS name and version-1 hash."""

    dds_name: str
    hash: str


ODOMETRY = RosType(
    "nav_msgs::msg::dds_::Odometry_",
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
)
TF_MESSAGE = RosType(
    "tf2_msgs::msg::dds_::TFMessage_",
    "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
)


@dataclass(frozen=True)
class RosTopic:
    """A published topic.

    Attributes:
        name: name without the first slash.
        type: message type.
        depth: QoS depth.

    Raises:
        InputError: the name is not valid in ROS 2.
    """

    name: str
    type: RosType
    depth: int

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
        zid: the session's Zenoh id.
        name: letters, digits and '_'.
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

        Its QoS is reliable, volatile, keep last `depth`; empty fields have ROS's defaults.

        Args:
            number: unique number of the publisher in this node.
            topic: the topic.
        """
        topic_name = "/" + topic.name
        parts = (_mangle(topic_name), topic.type.dds_name, topic.type.hash)
        return "/".join((self._liveliness_key(number, "MP"), *parts, f"::,{topic.depth}:,:,:,,"))

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
        sequence_number: number of the sample, from 1.
        source_ns: Unix time, nanoseconds.
        gid: 16 bytes from `publisher_gid`.
    """
    return _ATTACHMENT.pack(sequence_number, source_ns, _GID_BYTES) + gid


def _mangle(name: str) -> str:
    return name.replace("/", _EMPTY_PART)

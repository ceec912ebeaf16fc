"""How ROS 2's two ways over Zenoh name a topic, and what rmw_zenoh wants to know of its publisher.

zenoh-bridge-ros2dds uses the topic's name as the key. rmw_zenoh (Jazzy and later) has the type in
the key, with its hash (REP 2011), an attachment of 33 bytes with each sample, and liveliness tokens
from which nodes learn who publishes what (its docs/design.md, "Graph Cache" and "Publishers").
"""

import hashlib
import re
import struct
from dataclasses import dataclass

from drivers.core.errors import InputError

# Enclave and namespace, which we have none of: empty parts are not allowed in a key.
_EMPTY_PART = "%"
_GID_BYTES = 16
# Sequence number, source time in ns, and the length of the gid that follows, little endian.
_ATTACHMENT = struct.Struct("<qqB")


@dataclass(frozen=True)
class RosType:
    """A message type as rmw_zenoh writes it: its DDS name, and its hash of version 1."""

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
    """A topic that is published: its name without the first slash, its type, its QoS depth.

    Raises InputError for a name that ROS 2 would not take.
    """

    name: str
    type: RosType
    depth: int

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*", self.name):
            raise InputError(
                f"ros2.topic = {self.name!r}: use names of letters, digits and '_' that do not "
                "begin with a digit, separated by single slashes, without one at either end, such "
                "as vo/odom"
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
    """The node that we are to the others, on one Zenoh session.

    zid   the session's own number
    name  letters, digits and '_'
    """

    domain_id: int
    zid: str
    name: str

    @property
    def liveliness_token(self) -> str:
        """Key of the liveliness token that makes the node known."""
        return self._liveliness_key(0, "NN")

    def publisher_token(self, number: int, topic: RosTopic) -> str:
        """Key of the token that makes a publisher known; `number` tells it from its siblings.

        QoS: reliable, volatile, keep last `depth`; what is left empty has ROS's default.
        """
        topic_name = "/" + topic.name
        parts = (_mangle(topic_name), topic.type.dds_name, topic.type.hash)
        return "/".join((self._liveliness_key(number, "MP"), *parts, f"::,{topic.depth}:,:,:,,"))

    def _liveliness_key(self, number: int, kind: str) -> str:
        where = f"@ros2_lv/{self.domain_id}/{self.zid}/0/{number}"
        return f"{where}/{kind}/{_EMPTY_PART}/{_EMPTY_PART}/{self.name}"


def node_name(prefix: str) -> str:
    """A node's name for a Zenoh prefix: kinect_vo for kinect."""
    name = re.sub(r"\W", "_", prefix, flags=re.ASCII) + "_vo"
    return f"_{name}" if name[0].isdecimal() else name


def publisher_gid(token: str) -> bytes:
    """16 bytes that tell this publisher from any other, for readers that count what is lost.

    rmw_zenoh takes another hash of the same token (XXH3); nothing compares the two.
    """
    return hashlib.blake2b(token.encode(), digest_size=_GID_BYTES).digest()


def encode_attachment(sequence_number: int, source_ns: int, gid: bytes) -> bytes:
    """What goes with each sample: its number, from 1, and its time in ns since 1970."""
    return _ATTACHMENT.pack(sequence_number, source_ns, _GID_BYTES) + gid


def _mangle(name: str) -> str:
    return name.replace("/", _EMPTY_PART)

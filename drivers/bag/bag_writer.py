"""Files of ROS messages that are written: MCAP, ROS 2 bag, ROS 1 bag."""

import errno
import os
import sqlite3
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Literal

from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.convert.converter import migrate_message
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from rosbags.rosbag2.metadata import dump_qos_v8
from rosbags.typesys.store import Typestore

from drivers.bag.bag_file import ros1_typestore, ros2_typestore
from drivers.core.write_errors import check_growth

ROS2_BAG_VERSION: Literal[9] = 9
# Written once: a subscriber that starts later must still get them.
LATCHED_TOPICS = ("/tf_static", "/camera/camera_file")
NEVER = QosTime(9_223_372_036, 854_775_807)
# ROS 2 up to Iron reads the numbers of version 8 for quality of service, and later versions read
# them if the file says that it is that old. They take all other values from the file itself.
ROSBAG2_METADATA = """\
version: 4
storage_identifier: mcap
relative_file_paths: []
duration: {nanoseconds: 0}
starting_time: {nanoseconds_since_epoch: 0}
message_count: 0
topics_with_message_count: []
compression_format: ''
compression_mode: ''
"""


@dataclass(frozen=True)
class EncodedMessage:
    """An encoded message: in CDR, or as the file of its version of ROS stores it.

    Attributes:
        message_type: Such as "nav_msgs/msg/Odometry".
    """

    topic: str
    message_type: str
    log_ns: int
    data: bytes


class BagWriter(ABC):
    """Writes messages of any topic; a topic is made with its first message.

    Attributes:
        is_ros1: Whether headers have a sequence number, as in ROS 1.
        is_for_viewers: Whether people look at the file in Rerun and Foxglove.
    """

    is_ros1 = False
    is_for_viewers = False

    def __init__(self, store: Typestore) -> None:
        self.store = store
        self._channels: dict[str, Any] = {}

    def write(self, message: EncodedMessage) -> None:
        """Write a message of ROS 2, in CDR. Raises OSError."""
        self.write_stored(message)

    def encode(self, topic: str, message_type: str, message: Any) -> bytes:
        """Encode the next message of a topic as it is stored."""
        return bytes(self.store.serialize_cdr(message, message_type))

    def write_stored(self, message: EncodedMessage) -> None:
        """Write a message that is encoded as it is stored. Raises OSError."""
        if message.topic not in self._channels:
            self.add_topic(message.topic, message.message_type, self.store)
        self._write(self._channels[message.topic], message.log_ns, message.data)

    def add_topic(self, topic: str, message_type: str, store: Typestore) -> None:
        """Add a topic whose type is not defined by this object's `store`."""
        self._channels[topic] = self._add_channel(topic, message_type, store)

    @abstractmethod
    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any: ...

    @abstractmethod
    def _write(self, channel: Any, log_ns: int, data: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None:
        """Complete the file. Raises OSError."""


def offered_qos(topic: str) -> Qos:
    """Return the quality of service with which ROS 2 plays a topic."""
    is_latched = topic in LATCHED_TOPICS
    return Qos(
        QosHistory.KEEP_LAST,
        1 if is_latched else 10,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL if is_latched else QosDurability.VOLATILE,
        deadline=NEVER,
        lifespan=NEVER,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=NEVER,
        avoid_ros_namespace_conventions=False,
    )


class McapWriter(BagWriter):
    """Writes MCAP to an open file, in compressed chunks."""

    is_for_viewers = True

    def __init__(
        self, file: IO[bytes], compression: CompressionType = CompressionType.ZSTD
    ) -> None:
        super().__init__(ros2_typestore())
        self._file = file
        self._writer = McapLibraryWriter(file, compression=compression)
        self._writer.start(profile="ros2", library="kinect-vo")
        self._writer.add_metadata("rosbag2", {"serialized_metadata": ROSBAG2_METADATA})

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> int:
        definition, _ = store.generate_msgdef(message_type, ros_version=2)
        schema = self._writer.register_schema(message_type, "ros2msg", definition.encode())
        metadata = {"offered_qos_profiles": dump_qos_v8([offered_qos(topic)])}
        return self._writer.register_channel(topic, "cdr", schema, metadata)

    def _write(self, channel: int, log_ns: int, data: bytes) -> None:
        self._writer.add_message(channel, log_ns, data, publish_time=log_ns)

    def flush(self) -> None:
        """Hand everything written so far to the system, so that a crash does not lose it.

        Raises:
            OSError: Writing fails.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.flush()


class RosbagsWriter(BagWriter):
    """Writes a bag with the writers of rosbags."""

    _writer: Ros1LibraryWriter | Ros2LibraryWriter

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any:
        return self._writer.add_connection(topic, message_type, typestore=store)

    def _write(self, channel: Any, log_ns: int, data: bytes) -> None:
        self._writer.write(channel, log_ns, data)

    def close(self) -> None:
        self._writer.close()

    def abort(self) -> None:
        """Close the file without completing it."""
        self._writer.abort()


class Ros1Writer(RosbagsWriter):
    """Writes a ROS 1 bag, not compressed: ROS reads only LZ4 frames that rosbags does not write.

    The images are PNG or JPEG, from which compression of the chunks would save one percent.
    """

    is_ros1 = True
    _writer: Ros1LibraryWriter

    def __init__(self, path: Path) -> None:
        super().__init__(ros1_typestore())
        self._counts: Counter[str] = Counter()
        self._ros2 = ros2_typestore()
        self._migrated: dict[str, object] = {}  # a cache of rosbags
        self._writer = Ros1LibraryWriter(path)
        try:
            self._writer.open()
        except OSError:
            self.abort()
            raise

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any:
        latching = 1 if topic == "/tf_static" else None
        return self._writer.add_connection(topic, message_type, typestore=store, latching=latching)

    def write(self, message: EncodedMessage) -> None:
        kind = message.message_type
        ros2 = self._ros2.deserialize_cdr(message.data, kind)
        ros1 = migrate_message(self._ros2, self.store, kind, kind, self._migrated, ros2)
        self.write_stored(replace(message, data=self.encode(message.topic, kind, ros1)))

    def encode(self, topic: str, message_type: str, message: Any) -> bytes:
        """Encode a message; its header gets the number of the topic's messages before it."""
        if hasattr(message, "header"):
            message.header.seq = self._counts[topic]
            self._counts[topic] += 1
        return bytes(self.store.serialize_ros1(message, message_type))


class Ros2Writer(RosbagsWriter):
    """Writes a ROS 2 bag with SQLite into a new folder. Its path has no %, ? or #."""

    _writer: Ros2LibraryWriter

    def __init__(self, path: Path) -> None:
        super().__init__(ros2_typestore())
        self._writer = Ros2LibraryWriter(
            path, version=ROS2_BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3
        )
        self._writer.open()

    def _add_channel(self, topic: str, message_type: str, store: Typestore) -> Any:
        qos = [offered_qos(topic)]
        return self._writer.add_connection(
            topic, message_type, typestore=store, offered_qos_profiles=qos
        )


@contextmanager
def create_bag(path: Path, kind: str) -> Iterator[BagWriter]:
    """Create a bag; it is completed when the block ends, unless by an exception.

    Args:
        path: New file, or folder of a ROS 2 bag.
        kind: "mcap", "ros1" or "ros2".

    Raises:
        OSError: Writing fails.
    """
    if kind == "mcap":
        with path.open("wb") as file:
            mcap = McapWriter(file)
            yield mcap
            mcap.close()
        return
    try:
        bag = Ros1Writer(path) if kind == "ros1" else Ros2Writer(path)
        try:
            yield bag
            bag.close()
        except BaseException:
            bag.abort()
            raise
    except sqlite3.Error as error:  # of a ROS 2 bag
        if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)) from error
        check_growth(path / f"{path.name}.db3")  # SQLite does not name a quota or a limit
        raise OSError(errno.EIO, str(error)) from error

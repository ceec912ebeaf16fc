"""Writing of messages: MCAP, ROS 2 bag, ROS 1 bag."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Literal

from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from rosbags.typesys.store import Typestore

from drivers.bag.bag_file import ros1_typestore, ros2_typestore

ROS2_BAG_VERSION: Literal[9] = 9


@dataclass(frozen=True)
class EncodedMessage:
    """A message as it is stored: CDR for MCAP and ROS 2.

    Attributes:
        topic: Its topic.
        message_type: Such as "nav_msgs/msg/Odometry".
        log_ns: Its log time.
        data: The encoded message.
    """

    topic: str
    message_type: str
    log_ns: int
    data: bytes


class BagWriter(ABC):
    """Writes messages of any topic; a topic is made with its first message.

    Attributes:
        store: Types of the messages.
        is_ros1: Whether headers have a sequence number, as in ROS 1.
    """

    is_ros1 = False

    def __init__(self, store: Typestore) -> None:
        self.store = store
        self._channels: dict[str, Any] = {}

    def write(self, topic: str, message_type: str, log_ns: int, message: Any) -> None:
        """Write a message.

        Raises:
            OSError: Writing fails.
        """
        serialize = self.store.serialize_ros1 if self.is_ros1 else self.store.serialize_cdr
        data = bytes(serialize(message, message_type))
        self.write_encoded(EncodedMessage(topic, message_type, log_ns, data))

    def write_encoded(self, message: EncodedMessage) -> None:
        """Write a message that is encoded already.

        Raises:
            OSError: Writing fails.
        """
        topic = message.topic
        if topic not in self._channels:
            self._channels[topic] = self._add_channel(topic, message.message_type)
        self._write(self._channels[topic], message.log_ns, message.data)

    @abstractmethod
    def _add_channel(self, topic: str, message_type: str) -> Any: ...

    @abstractmethod
    def _write(self, channel: Any, log_ns: int, data: bytes) -> None: ...

    @abstractmethod
    def close(self) -> None:
        """Complete the file. Raises OSError."""


class McapWriter(BagWriter):
    """Writes MCAP to an open file, in chunks compressed with LZ4."""

    def __init__(self, file: IO[bytes]) -> None:
        super().__init__(ros2_typestore())
        self._file = file
        self._writer = McapLibraryWriter(file, compression=CompressionType.LZ4)
        self._writer.start(profile="ros2", library="kinect-vo")

    def _add_channel(self, topic: str, message_type: str) -> int:
        definition, _ = self.store.generate_msgdef(message_type, ros_version=2)
        schema = self._writer.register_schema(message_type, "ros2msg", definition.encode())
        return self._writer.register_channel(topic, "cdr", schema)

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


class Ros1Writer(BagWriter):
    """Writes a ROS 1 bag."""

    is_ros1 = True

    def __init__(self, path: Path) -> None:
        super().__init__(ros1_typestore())
        self._writer = Ros1LibraryWriter(path)
        self._writer.set_compression(Ros1LibraryWriter.CompressionFormat.LZ4)
        self._writer.open()

    def _add_channel(self, topic: str, message_type: str) -> Any:
        return self._writer.add_connection(topic, message_type, typestore=self.store)

    def _write(self, channel: Any, log_ns: int, data: bytes) -> None:
        self._writer.write(channel, log_ns, data)

    def close(self) -> None:
        self._writer.close()

    def abort(self) -> None:
        """Close the file without completing it."""
        self._writer.abort()


class Ros2Writer(BagWriter):
    """Writes a ROS 2 bag with SQLite into a new folder."""

    def __init__(self, path: Path) -> None:
        super().__init__(ros2_typestore())
        self._writer = Ros2LibraryWriter(
            path, version=ROS2_BAG_VERSION, storage_plugin=StoragePlugin.SQLITE3
        )
        self._writer.open()

    def _add_channel(self, topic: str, message_type: str) -> Any:
        return self._writer.add_connection(topic, message_type, typestore=self.store)

    def _write(self, channel: Any, log_ns: int, data: bytes) -> None:
        self._writer.write(channel, log_ns, data)

    def close(self) -> None:
        self._writer.close()

    def abort(self) -> None:
        """Close the file without completing it."""
        self._writer.abort()

"""The messages of a bag: MCAP, SQLite (ROS 2) or ROS 1, in one file or in several.

The layouts of the messages are those of the ROS distributions, so files without definitions can be
read too.
"""

from abc import ABC, abstractmethod
from collections import ChainMap
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, ClassVar, Self

from backports import zstd
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Schema
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drivers.bag.bag_storage import BagStorage, StorageFile
from drivers.core import InputError
from drivers.ros_messages.navigation import TRANSFORMS_SCHEMA

# No message in CDR begins so.
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
TF_MESSAGE_TYPES = (TRANSFORMS_SCHEMA, "tf/msg/tfMessage")


@dataclass(frozen=True)
class Message:
    """One message, not decoded.

    Attributes:
        log_ns: When it was recorded, ns.
    """

    topic: str
    log_ns: int
    data: bytes


class BagFile(ABC):
    """An open file of messages. Use as a context manager.

    Attributes:
        path: The file, or the folder of its parts.
        types: Type of each topic, such as "sensor_msgs/msg/Image".
        definitions: Definition of each topic's type, as far as the file has them.
        is_cut_off: The file has no end, because its writer was killed.
        is_ros1: Whether the messages are encoded as in ROS 1; otherwise they are CDR.
        unread: Type and encoding of each topic that cannot be read.
    """

    is_ros1 = False

    def __init__(
        self,
        path: Path,
        types: Mapping[str, str],
        definitions: Mapping[str, str],
        is_cut_off: bool = False,
        unread: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.path, self.types, self.definitions = path, types, definitions
        self.is_cut_off, self.unread = is_cut_off, unread
        self._store = ros1_typestore() if self.is_ros1 else ros2_typestore()

    @abstractmethod
    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]: ...

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Iterator[Message]:
        """Yield the messages of some topics that were recorded at `start_ns` or later.

        Raises:
            InputError: The file is damaged.
        """
        try:
            yield from self._messages(topics, start_ns)
        except DAMAGE_ERRORS as error:
            raise damage_error(self.path, error) from error

    def decode(self, message: Message) -> Any:
        """Decode a message to an object with the fields of its type.

        Raises:
            InputError: The message does not have the layout of its type.
        """
        message_type, store = self.types[message.topic], self._store
        deserialize = store.deserialize_ros1 if self.is_ros1 else store.deserialize_cdr
        try:
            return deserialize(message.data, message_type)
        except DAMAGE_ERRORS as error:
            raise InputError(
                f"{self.path}: a message of {message.topic} is no {message_type}"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()


def stamp_ns_of(decoded: Any, log_ns: int = 0) -> int:
    """Return the stamp in a decoded message's header, or its log time if it has none, in ns."""
    stamp = decoded.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec) or log_ns


# The libraries report damage with their own exceptions, and with those of what they call.
DAMAGE_ERRORS = (Exception,)


def damage_error(path: Path, error: Exception) -> InputError:
    """Make the error for a file that cannot be read, with what to do."""
    reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
    if "not indexed" in reason or "index looks damaged" in reason:
        return InputError(
            f"{path}: the bag has no usable index, because it was not closed or cut off; "
            "run `rosbag reindex` on it"
        )
    return InputError(f"{path}: cannot be read: {reason}; record or copy it again")


def open_bag_file(storage: BagStorage) -> BagFile:
    """Open the files of a bag as one. Raises InputError."""
    with ExitStack() as opened:
        parts = [opened.enter_context(_open_part(file)) for file in storage.files]
        if len({type(part) for part in parts}) > 1:
            raise InputError(f"{storage.path}: its files are of several formats; name one file")
        bag = parts[0] if len(parts) == 1 else SplitBagFile(storage.path, parts)
        opened.pop_all()
    return bag


def _open_part(file: StorageFile) -> BagFile:
    kinds = {".mcap": McapFile, ".db3": SqliteFile}
    try:
        return kinds.get(file.content.suffix.lower(), Ros1File)(file)
    except DAMAGE_ERRORS as error:
        raise damage_error(file.path, error) from error


def ros1_typestore() -> Typestore:
    """Make the types of ROS 1, with both kinds of transforms."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in TF_MESSAGE_TYPES:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def ros2_typestore() -> Typestore:
    """Make the types of ROS 2."""
    return get_typestore(Stores.ROS2_JAZZY)


def _decompress(data: bytes) -> bytes:
    """Decompress a message of ROS 2, if it was recorded with `--compression-mode message`."""
    return zstd.decompress(data) if data.startswith(ZSTD_MAGIC) else data


class RosbagsFile(BagFile):
    """A file that rosbags reads."""

    reader_type: ClassVar[type[Ros1Reader | Ros2Reader]]

    def __init__(self, file: StorageFile) -> None:
        self._opened = ExitStack()
        reader = self._reader = self.reader_type(file.content)
        reader.open()
        self._opened.callback(reader.close)
        types = {each.topic: each.msgtype for each in reader.connections}
        definitions = {
            each.topic: each.msgdef.data
            for each in reader.connections
            if each.msgdef.format is MessageDefinitionFormat.MSG
        }
        super().__init__(file.path, types, definitions)

    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]:
        connections = [each for each in self._reader.connections if each.topic in topics]
        if connections:  # an empty list would mean all
            for connection, log_ns, data in self._reader.messages(connections, start_ns):
                plain = bytes(data) if self.is_ros1 else _decompress(bytes(data))
                yield Message(connection.topic, log_ns, plain)

    def close(self) -> None:
        self._opened.close()


class Ros1File(RosbagsFile):
    """A ROS 1 bag."""

    is_ros1, reader_type = True, Ros1Reader


class SqliteFile(RosbagsFile):
    """A ROS 2 bag in SQLite."""

    reader_type = Ros2Reader


class SplitBagFile(BagFile):
    """The parts of a split recording, one after the other."""

    def __init__(self, path: Path, parts: Sequence[BagFile]) -> None:
        self._parts = parts
        self.is_ros1 = parts[0].is_ros1
        types = ChainMap(*(dict(part.types) for part in parts))
        definitions = ChainMap(*(dict(part.definitions) for part in parts))
        unread = ChainMap(*(dict(part.unread) for part in parts))
        is_cut_off = any(part.is_cut_off for part in parts)
        super().__init__(path, types, definitions, is_cut_off, unread)

    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]:
        for part in self._parts:
            yield from part.messages(topics, start_ns)

    def close(self) -> None:
        for part in self._parts:
            part.close()


class McapFile(BagFile):
    """One MCAP file, complete or cut off."""

    def __init__(self, file: StorageFile) -> None:
        self._file: BinaryIO = file.content.open("rb")
        try:
            schemas, unread, is_cut_off = self._read_channels()
        except BaseException:
            self._file.close()
            raise
        types = {topic: schema.name for topic, schema in schemas.items()}
        definitions = {
            topic: schema.data.decode(errors="replace")
            for topic, schema in schemas.items()
            if schema.encoding == "ros2msg"
        }
        super().__init__(file.path, types, definitions, is_cut_off, unread)

    def _read_channels(self) -> tuple[dict[str, Schema], dict[str, str], bool]:
        """Return topics in CDR with their schema, descriptions of others, whether it is cut off."""
        try:
            summary = make_reader(self._file).get_summary()
        except DAMAGE_ERRORS:
            summary = None
        channels = (
            ((schema, channel) for schema, channel, _ in self._iterate_to_end(None, 0))
            if summary is None
            else ((summary.schemas.get(c.schema_id), c) for c in summary.channels.values())
        )
        found, unread = {}, {}
        for schema, channel in channels:
            encoding = channel.message_encoding
            if schema is not None and encoding == "cdr":
                found[channel.topic] = schema
            else:
                name = "no type" if schema is None else schema.name
                unread[channel.topic] = f"{name} in the encoding {encoding or 'unknown'}"
        return found, unread, summary is None

    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]:
        if self.is_cut_off:
            records = self._iterate_to_end(topics, start_ns)
        else:
            self._file.seek(0)
            reader: McapReader = make_reader(self._file)
            records = reader.iter_messages(list(topics), start_time=start_ns)
        for _, channel, message in records:
            yield Message(channel.topic, message.log_time, _decompress(message.data))

    def _iterate_to_end(self, topics: Collection[str] | None, start_ns: int) -> Iterator[Any]:
        """Yield the messages of a file up to its last whole chunk, in the order of writing."""
        self._file.seek(0)
        reader = NonSeekingReader(self._file)
        names = None if topics is None else list(topics)
        try:
            yield from reader.iter_messages(names, start_time=start_ns, log_time_order=False)
        except DAMAGE_ERRORS:
            return

    def close(self) -> None:
        self._file.close()

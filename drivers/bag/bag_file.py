"""The messages of a file: MCAP, a ROS 2 bag (folder, .db3 or .mcap) or a ROS 1 bag.

The layouts of the messages are those of the ROS distributions, so files without definitions can be
read too.
"""

from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Self

from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Schema
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drivers.core import InputError

STORAGE_SUFFIXES = (".db3", ".mcap")
TF_MESSAGE_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")


@dataclass(frozen=True)
class Message:
    """One message, not decoded.

    Attributes:
        topic: Its topic.
        log_ns: When it was recorded, ns.
        data: The encoded message.
    """

    topic: str
    log_ns: int
    data: bytes


class BagFile(ABC):
    """An open file of messages. Use as a context manager.

    Attributes:
        path: The file, or the folder of a ROS 2 bag.
        types: Type of each topic, such as "sensor_msgs/msg/Image".
        definitions: Definition of each topic's type, as far as the file has them.
        is_cut_off: The file has no end, because its writer was killed.
        is_ros1: Whether the messages are encoded as in ROS 1; otherwise they are CDR.
    """

    is_ros1 = False

    def __init__(
        self,
        path: Path,
        types: Mapping[str, str],
        definitions: Mapping[str, str],
        is_cut_off: bool = False,
    ) -> None:
        self.path, self.types, self.definitions = path, types, definitions
        self.is_cut_off = is_cut_off

    @abstractmethod
    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]: ...

    @abstractmethod
    def _decode(self, data: bytes, message_type: str) -> Any: ...

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
        message_type = self.types[message.topic]
        try:
            return self._decode(message.data, message_type)
        except DAMAGE_ERRORS as error:
            raise InputError(
                f"{self.path}: a message of {message.topic} is no {message_type}"
            ) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_exc: object) -> None:
        self.close()


# The libraries report damage with their own exceptions, and with those of what they call.
DAMAGE_ERRORS = (Exception,)


def damage_error(path: Path, error: Exception) -> InputError:
    """Make the error for a file that cannot be read, with what to do."""
    reason = str(error) or type(error).__name__
    if "not indexed" in reason or "index looks damaged" in reason:
        return InputError(
            f"{path}: the bag has no usable index, because it was cut off; "
            "run `rosbag reindex` on it"
        )
    return InputError(f"{path}: cannot be read: {reason}; record or copy it again")


def open_bag_file(path: Path) -> BagFile:
    """Open a file of messages.

    Raises:
        InputError: It does not exist, or it is damaged.
    """
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    storage = _find_storage(path)
    try:
        suffix = "" if storage.is_dir() else storage.suffix.lower()
        if suffix == ".mcap":
            return McapFile(storage)
        return Ros1File(storage) if suffix == ".bag" else Ros2File(storage)
    except InputError:
        raise
    except DAMAGE_ERRORS as error:
        raise damage_error(path, error) from error


def _find_storage(path: Path) -> Path:
    """Return the file to open; a ROS 2 bag that was cut off has one file and no metadata."""
    if not path.is_dir() or (path / "metadata.yaml").exists():
        return path
    files = [file for file in path.iterdir() if file.suffix in STORAGE_SUFFIXES]
    if len(files) != 1:
        raise InputError(
            f"{path}: has no metadata.yaml and {len(files)} files of messages; run "
            "`ros2 bag reindex` on it, or name one file"
        )
    return files[0]


def ros1_typestore() -> Typestore:
    """Make the types of ROS 1, with both kinds of transforms."""
    store = get_typestore(Stores.ROS1_NOETIC)
    for name in TF_MESSAGE_TYPES:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def ros2_typestore() -> Typestore:
    """Make the types of ROS 2."""
    return get_typestore(Stores.ROS2_JAZZY)


class RosbagsFile(BagFile):
    """A bag that rosbags reads."""

    def __init__(self, path: Path, reader: Ros1Reader | Ros2Reader, store: Typestore) -> None:
        self._reader, self._store = reader, store
        reader.open()
        types = {each.topic: each.msgtype for each in reader.connections}
        definitions = {
            each.topic: each.msgdef.data
            for each in reader.connections
            if each.msgdef.format is MessageDefinitionFormat.MSG
        }
        super().__init__(path, types, definitions)

    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]:
        connections = [each for each in self._reader.connections if each.topic in topics]
        if connections:  # an empty list would mean all
            for connection, log_ns, data in self._reader.messages(connections, start_ns):
                yield Message(connection.topic, log_ns, bytes(data))


class Ros1File(RosbagsFile):
    """A ROS 1 bag."""

    is_ros1 = True

    def __init__(self, path: Path) -> None:
        self._bag = Ros1Reader(path)
        super().__init__(path, self._bag, ros1_typestore())

    def _decode(self, data: bytes, message_type: str) -> Any:
        return self._store.deserialize_ros1(data, message_type)

    def close(self) -> None:
        if self._bag.bio is not None:
            self._bag.close()


class Ros2File(RosbagsFile):
    """A ROS 2 bag: its folder, or one file of SQLite."""

    def __init__(self, path: Path) -> None:
        self._bag = Ros2Reader(path)
        super().__init__(path, self._bag, ros2_typestore())

    def _decode(self, data: bytes, message_type: str) -> Any:
        return self._store.deserialize_cdr(data, message_type)

    def close(self) -> None:
        if self._bag.is_open:
            self._bag.close()


class McapFile(BagFile):
    """One MCAP file, complete or cut off."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("rb")
        try:
            schemas, is_cut_off = self._read_schemas(path)
        except BaseException:
            self._file.close()
            raise
        self._store = ros2_typestore()
        types = {topic: schema.name for topic, schema in schemas.items()}
        definitions = {
            topic: schema.data.decode(errors="replace")
            for topic, schema in schemas.items()
            if schema.encoding == "ros2msg"
        }
        super().__init__(path, types, definitions, is_cut_off)

    def _read_schemas(self, path: Path) -> tuple[dict[str, Schema], bool]:
        """Return the schema of each topic in CDR, and whether the file is cut off."""
        try:
            summary = make_reader(self._file).get_summary()
        except DAMAGE_ERRORS:
            summary = None
        if summary is not None:
            schemas, channels = summary.schemas, summary.channels.values()
            found = {
                each.topic: schemas[each.schema_id]
                for each in channels
                if each.schema_id in schemas and each.message_encoding == "cdr"
            }
            return found, False
        found = {}
        for schema, channel, _ in self._iterate_to_end(None, 0):
            if schema is not None and channel.message_encoding == "cdr":
                found[channel.topic] = schema
        if not found:
            raise InputError(f"{path}: holds no messages of ROS 2; is it a complete MCAP file?")
        return found, True

    def _messages(self, topics: Collection[str], start_ns: int) -> Iterator[Message]:
        if self.is_cut_off:
            records = self._iterate_to_end(topics, start_ns)
        else:
            self._file.seek(0)
            reader: McapReader = make_reader(self._file)
            records = reader.iter_messages(list(topics), start_time=start_ns)
        for _, channel, message in records:
            yield Message(channel.topic, message.log_time, message.data)

    def _iterate_to_end(self, topics: Collection[str] | None, start_ns: int) -> Iterator[Any]:
        """Yield the messages of a file up to its last whole chunk, in the order of writing."""
        self._file.seek(0)
        reader = NonSeekingReader(self._file)
        names = None if topics is None else list(topics)
        try:
            yield from reader.iter_messages(names, start_time=start_ns, log_time_order=False)
        except DAMAGE_ERRORS:
            return

    def _decode(self, data: bytes, message_type: str) -> Any:
        return self._store.deserialize_cdr(data, message_type)

    def close(self) -> None:
        self._file.close()

"""Copying of messages from one file to another, also between ROS 1 and ROS 2."""

from collections.abc import Callable, Collection, Iterator
from functools import partial

from rosbags.convert.converter import migrate_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from drivers.bag.bag_file import (
    DAMAGE_ERRORS,
    TF_MESSAGE_TYPES,
    BagFile,
    Message,
    ros1_typestore,
    ros2_typestore,
)
from drivers.bag.bag_writer import BagWriter, EncodedMessage

HEADER = "std_msgs/msg/Header"


class MessageCopier:
    """Copies messages with their topics, log times and contents.

    Between files of one ROS version the encoded messages are copied as they are.

    Args:
        source: The file to read.
        writer: Writes the copies.

    Attributes:
        left_out: Topics of which messages could not be copied.
    """

    def __init__(self, source: BagFile, writer: BagWriter) -> None:
        self._source, self._writer = source, writer
        self._copies: dict[str, Callable[[Message], None]] = {}
        self.left_out: set[str] = set()

    def copies(self, topics: Collection[str]) -> Iterator[tuple[int, Callable[[], None]]]:
        """Yield the log time of each message, ns, and a function that copies it.

        Raises:
            InputError: The file is damaged.
        """
        for topic in topics:
            try:
                self._copies[topic] = self._make_copy(topic)
            except DAMAGE_ERRORS:  # the definition is missing, or is none
                self.left_out.add(topic)
        for message in self._source.messages(self._copies):
            yield message.log_ns, partial(self._copy, message)

    def _copy(self, message: Message) -> None:
        try:
            self._copies[message.topic](message)
        except OSError:
            raise
        except DAMAGE_ERRORS:  # it does not have the layout of its type
            self.left_out.add(message.topic)

    def _make_copy(self, topic: str) -> Callable[[Message], None]:
        """Return a function that copies a message of a topic."""
        kind, store = self._source.types[topic], self._types_of(topic)
        if self._source.is_ros1 == self._writer.is_ros1:
            self._writer.add_topic(topic, kind, store)
            return partial(self._copy_encoded, kind)
        ros2_kind = TF_MESSAGE_TYPES[0] if kind in TF_MESSAGE_TYPES else kind
        self._add_type(ros2_kind, kind, store)
        deserialize = store.deserialize_ros1 if self._source.is_ros1 else store.deserialize_cdr
        migrate = partial(migrate_message, store, self._writer.store, kind, ros2_kind, {})

        def copy(message: Message) -> None:
            migrated = migrate(deserialize(message.data, kind))
            self._writer.write(topic, ros2_kind, message.log_ns, migrated)

        return copy

    def _copy_encoded(self, kind: str, message: Message) -> None:
        encoded = EncodedMessage(message.topic, kind, message.log_ns, message.data)
        self._writer.write_encoded(encoded)

    def _types_of(self, topic: str) -> Typestore:
        """Return the types of a topic by the file's definitions, else by the ROS distribution's."""
        definition = self._source.definitions.get(topic)
        if not definition:
            return ros1_typestore() if self._source.is_ros1 else ros2_typestore()
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(definition, self._source.types[topic]))
        return store

    def _add_type(self, kind: str, source_kind: str, store: Typestore) -> None:
        """Make a type known to the writer."""
        known = self._writer.store
        if kind not in known.types:
            new = {
                name: fields for name, fields in store.fielddefs.items() if name not in known.types
            }
            known.register(new)

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


class MessageCopier:
    """Copies messages with their topics, log times and contents.

    Between files of one ROS version the encoded messages are copied as they are.

    Attributes:
        left_out: Topics of which messages could not be copied.
    """

    def __init__(self, source: BagFile, writer: BagWriter) -> None:
        self._source, self._writer = source, writer
        self._translations: dict[str, Callable[[Message], EncodedMessage]] = {}
        self.left_out: set[str] = set()

    def copies(self, topics: Collection[str]) -> Iterator[tuple[int, Callable[[], None]]]:
        """Yield the log time of each message, ns, and a function that copies it.

        Raises:
            InputError: The file is damaged.
        """
        for topic in topics:
            try:
                types = self._types_of(topic)
            except DAMAGE_ERRORS:  # the definition cannot be parsed
                self.left_out.add(topic)
            else:
                self._add_topic(topic, types)
        for message in self._source.messages(self._translations):
            yield message.log_ns, partial(self._copy, message)

    def _copy(self, message: Message) -> None:
        try:
            encoded = self._translations[message.topic](message)
        except DAMAGE_ERRORS:  # it does not have the layout of its type
            self.left_out.add(message.topic)
        else:
            self._writer.write_stored(encoded)

    def _add_topic(self, topic: str, types: Typestore) -> None:
        kind = self._source.types[topic]
        if kind not in types.types:
            self.left_out.add(topic)
        elif self._source.is_ros1 == self._writer.is_ros1:
            self._writer.add_topic(topic, kind, types)
            self._translations[topic] = lambda m: EncodedMessage(topic, kind, m.log_ns, m.data)
        else:
            self._translations[topic] = self._make_translation(topic, kind, types)

    def _make_translation(
        self, topic: str, kind: str, types: Typestore
    ) -> Callable[[Message], EncodedMessage]:
        """Return a function that encodes a message for the other ROS version."""
        writer, known = self._writer, self._writer.store
        new_kind = TF_MESSAGE_TYPES[0] if kind in TF_MESSAGE_TYPES else kind
        if new_kind not in known.types:
            known.register({k: v for k, v in types.fielddefs.items() if k not in known.types})
        decode = types.deserialize_ros1 if self._source.is_ros1 else types.deserialize_cdr
        migrate = partial(migrate_message, types, known, kind, new_kind, {})

        def translate(message: Message) -> EncodedMessage:
            data = writer.encode(topic, new_kind, migrate(decode(message.data, kind)))
            return EncodedMessage(topic, new_kind, message.log_ns, data)

        return translate

    def _types_of(self, topic: str) -> Typestore:
        """Return the types of a topic by the file's definitions, else by the ROS distribution's."""
        definition = self._source.definitions.get(topic)
        if not definition:
            return ros1_typestore() if self._source.is_ros1 else ros2_typestore()
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(definition, self._source.types[topic]))
        return store

"""Messages of a base's odometry that were recorded beside the frames of a bag."""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path

from rosbags.convert.converter import migrate_message

from drivers.bag.bag_file import BagFile, Message, open_bag_file, ros1_typestore, ros2_typestore
from drivers.bag.bag_storage import BagStorage
from drivers.ros_messages.navigation import ODOMETRY_SCHEMA


def read_odometry_messages(path: Path, topics: Collection[str]) -> Iterator[bytes]:
    """Yield the messages of some topics in CDR, in the order of recording.

    The file is open until the last one.

    Args:
        path: The bag.
        topics: Topics; those that are absent, or of another type, have no messages.

    Raises:
        InputError: The file is damaged.
    """
    with open_bag_file(BagStorage(path)) as bag:
        present = [topic for topic in topics if bag.types.get(topic) == ODOMETRY_SCHEMA]
        if not present:
            return
        encode = _cdr_encoder(bag)
        for message in bag.messages(present):
            yield encode(message)


def _cdr_encoder(bag: BagFile) -> Callable[[Message], bytes]:
    """Return a function that encodes a message as CDR: as it is, or translated from ROS 1."""
    if not bag.is_ros1:
        return lambda message: message.data
    ros1, ros2 = ros1_typestore(), ros2_typestore()

    def translate(message: Message) -> bytes:
        decoded = migrate_message(
            ros1, ros2, ODOMETRY_SCHEMA, ODOMETRY_SCHEMA, {}, bag.decode(message)
        )
        return bytes(ros2.serialize_cdr(decoded, ODOMETRY_SCHEMA))

    return translate

"""Messages as rosbags reads them."""

from typing import Any

from rosbags.typesys import Stores, get_typestore

_ROS = get_typestore(Stores.ROS2_JAZZY)


def read_with_rosbags(encoded: bytes, schema: str) -> Any:
    """Return what rosbags reads; rosbags writes it as the same bytes."""
    message = _ROS.deserialize_cdr(encoded, schema)
    assert bytes(_ROS.serialize_cdr(message, schema)) == encoded
    return message

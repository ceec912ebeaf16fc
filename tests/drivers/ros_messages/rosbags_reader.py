"""Messages as rosbags reads them, and what headers may hold."""

from typing import Any

from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from drivers.ros_messages.cdr import split_stamp

_ROS = get_typestore(Stores.ROS2_JAZZY)
frame_ids = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), max_size=30)
stamps = st.floats(0.0, 2.0**31 - 1)


def read_with_rosbags(encoded: bytes, schema: str) -> Any:
    """Return what rosbags reads; rosbags writes it as the same bytes."""
    message = _ROS.deserialize_cdr(encoded, schema)
    assert bytes(_ROS.serialize_cdr(message, schema)) == encoded
    return message


def check_header(read: Any, stamp_s: float, frame_id: str) -> None:
    """Compare the header that rosbags has read."""
    stamp = read.header.stamp.sec, read.header.stamp.nanosec
    assert (*stamp, read.header.frame_id) == (*split_stamp(stamp_s), frame_id)

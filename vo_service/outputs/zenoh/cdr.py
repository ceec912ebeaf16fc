"""Plain CDR encoding of `nav_msgs/msg/Odometry` and `geometry_msgs/msg/TransformStamped`.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the fields in order. Each field is
aligned to its own size, counted from the end of the header (OMG DDS-XTypes, "plain CDR").
"""

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose

CDR_HEADER = b"\x00\x01\x00\x00"

_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
ODOMETRY_SCHEMA = "nav_msgs/msg/Odometry"
# position 3, quaternion 4, covariance 36, twist 6, covariance 36
_NUMBERS = 85
TRANSFORM_SCHEMA = "geometry_msgs/msg/TransformStamped"
# translation 3, quaternion 4
_TRANSFORM_NUMBERS = 7


def append_length(body: bytes, count: int) -> bytes:
    """Append the number of items that follow."""
    return _pad_to(body, 4) + _LENGTH.pack(count)


def append_frames(body: bytes, stamp_s: float, frame_id: str, child_frame_id: str) -> bytes:
    """Append a ``std_msgs/msg/Header`` and the child frame's name.

    Raises:
        ValueError: The stamp does not fit.
    """
    body = _pad_to(body, 4) + _STAMP.pack(*split_stamp(stamp_s))
    return _append_string(_append_string(body, frame_id), child_frame_id)


def append_numbers(body: bytes, numbers: Array) -> bytes:
    """Append 64-bit floats."""
    return _pad_to(body, 8) + numbers.astype("<f8").tobytes()


@contextmanager
def reraise_as_value_error(schema: str) -> Iterator[None]:
    """Turn decoding errors in the block into a ValueError that names the message type."""
    try:
        yield
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"not a {schema} message: {error}") from error


def strip_header(payload: bytes) -> bytes:
    """Remove the header.

    Raises:
        ValueError: If it is not little-endian CDR.
    """
    if payload[:4] != CDR_HEADER:
        raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
    return payload[4:]


def read_frames(body: bytes) -> tuple[float, str, str, int]:
    """Read the header and child frame at the start of a message.

    Returns:
        Stamp in seconds, frame, child frame, and the offset after them.

    Raises:
        Exception: The errors that `reraise_as_value_error` handles.
    """
    sec, nanosec = _STAMP.unpack_from(body)
    frame_id, offset = _read_string(body, _STAMP.size)
    child_frame_id, offset = _read_string(body, offset)
    return sec + nanosec * 1e-9, frame_id, child_frame_id, offset


def read_numbers(body: bytes, offset: int, count: int) -> Array:
    """Read `count` 64-bit floats after an offset.

    Raises:
        ValueError: If there are fewer.
    """
    return np.frombuffer(body, "<f8", count, _aligned_offset(offset, 8)).astype(np.float64)


def split_stamp(stamp_s: float) -> tuple[int, int]:
    """Split a stamp into whole seconds, rounded down, and nanoseconds (0 to 999 999 999).

    Raises:
        ValueError: The seconds do not fit ROS 2's 32 signed bits (they end in 2038).
    """
    if not math.isfinite(stamp_s):
        raise ValueError(f"stamp {stamp_s} is not a time")
    sec = math.floor(stamp_s)
    # The subtraction is exact, so this is the nearest nanosecond; it may round up to a second.
    carry, nanosec = divmod(round((stamp_s - sec) * 1e9), 1_000_000_000)
    sec += carry
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"stamp {stamp_s} s does not fit ROS 2's 32 bits for seconds")
    return sec, nanosec


def _aligned_offset(offset: int, size: int) -> int:
    return offset + -offset % size


def _pad_to(body: bytes, size: int) -> bytes:
    return body.ljust(_aligned_offset(len(body), size), b"\x00")


def _append_string(body: bytes, text: str) -> bytes:
    encoded = text.encode() + b"\x00"
    return append_length(body, len(encoded)) + encoded


def _read_string(body: bytes, offset: int) -> tuple[str, int]:
    start = _aligned_offset(offset, 4) + _LENGTH.size
    (length,) = _LENGTH.unpack_from(body, start - _LENGTH.size)
    if start + length > len(body):
        raise ValueError("a string is longer than the message")
    return body[start : start + length].rstrip(b"\x00").decode(), start + length


@dataclass(frozen=True)
class OdometryMessage:
    """One odometry message.

    Attributes:
        stamp_s: Stamp of the pose, Unix seconds.
        frame_id: Parent frame of the pose.
        child_frame_id: Frame that moves; the twist is in its axes.
        T_frame_child: 4x4 pose, meters.
        pose_covariance: 6x6, order x y z rx ry rz, axes of `frame_id`.
        twist: (6,) m/s and rad/s.
        twist_covariance: 6x6.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array
    pose_covariance: Array
    twist: Array
    twist_covariance: Array

    @property
    def position_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        position: Array = self.T_frame_child[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_odometry(message: OdometryMessage) -> bytes:
    """Encode a message as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    numbers = np.concatenate(
        [
            message.position_m,
            message.quaternion_xyzw,
            message.pose_covariance.ravel(),
            message.twist,
            message.twist_covariance.ravel(),
        ]
    )
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"odometry at {message.stamp_s} s has a number that is not finite")
    body = append_frames(b"", message.stamp_s, message.frame_id, message.child_frame_id)
    return CDR_HEADER + append_numbers(body, numbers)


def decode_odometry(payload: bytes) -> OdometryMessage:
    """Decode a message from `encode_odometry` or any ROS 2 node.

    Raises:
        ValueError: The bytes are not a little-endian Odometry message.
    """
    body = strip_header(payload)
    with reraise_as_value_error(ODOMETRY_SCHEMA):
        stamp_s, frame_id, child_frame_id, offset = read_frames(body)
        numbers = read_numbers(body, offset, _NUMBERS)
    return OdometryMessage(
        stamp_s=stamp_s,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        T_frame_child=transform_from_pose(numbers[:3], numbers[3:7]),
        pose_covariance=numbers[7:43].reshape(6, 6),
        twist=numbers[43:49],
        twist_covariance=numbers[49:85].reshape(6, 6),
    )


@dataclass(frozen=True)
class TransformMessage:
    """Transform between two frames.

    Attributes:
        stamp_s: Stamp of the transform, Unix seconds.
        frame_id: Parent frame.
        child_frame_id: Child frame.
        T_frame_child: 4x4, meters.
    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    T_frame_child: Array

    @property
    def translation_m(self) -> Array:
        """(3,) position of the child frame, meters."""
        translation: Array = self.T_frame_child[:3, 3]
        return translation

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) orientation of the child frame."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_transform(message: TransformMessage) -> bytes:
    """Encode a ``TransformStamped`` as CDR.

    Raises:
        ValueError: A number is not finite, or the stamp does not fit.
    """
    return CDR_HEADER + _append_transform(b"", message)


def encode_transforms(messages: Sequence[TransformMessage]) -> bytes:
    """Encode transforms as one ``TFMessage``. Raises as `encode_transform`."""
    body = append_length(b"", len(messages))
    for message in messages:
        body = _append_transform(body, message)
    return CDR_HEADER + body


def decode_transform(payload: bytes) -> TransformMessage:
    """Decode a message from `encode_transform` or any ROS 2 node.

    Raises:
        ValueError: The bytes are not a little-endian TransformStamped message.
    """
    body = strip_header(payload)
    with reraise_as_value_error(TRANSFORM_SCHEMA):
        stamp_s, frame_id, child_frame_id, offset = read_frames(body)
        numbers = read_numbers(body, offset, _TRANSFORM_NUMBERS)
        T_frame_child = transform_from_pose(numbers[:3], numbers[3:])
    return TransformMessage(stamp_s, frame_id, child_frame_id, T_frame_child)


def _append_transform(body: bytes, message: TransformMessage) -> bytes:
    if not np.all(np.isfinite(message.T_frame_child)):
        raise ValueError(f"transform at {message.stamp_s} s has a number that is not finite")
    body = append_frames(body, message.stamp_s, message.frame_id, message.child_frame_id)
    numbers = np.concatenate([message.translation_m, message.quaternion_xyzw])
    return append_numbers(body, numbers)

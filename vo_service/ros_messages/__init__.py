"""ROS 2 messages in plain CDR, and those of poses and transforms. Needs only numpy.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the fields in order. Each field is
aligned to its own size, counted from the end of the header (OMG DDS-XTypes, "plain CDR").
`sensors` has the messages of a camera.
"""

import math
import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array, quaternion_from_rotation, transform_from_pose

CDR_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
# Anything that gives its bytes without a copy; an array must be contiguous.
BytesLike = bytes | bytearray | memoryview | NDArray[Any]


class CdrWriter:
    """Writes the fields of one message, in order."""

    def __init__(self) -> None:
        self._parts: list[bytes | memoryview] = [CDR_HEADER]
        self._length = 0  # without the header

    def uint8(self, value: int) -> None:
        """Write an 8-bit number."""
        self._append(struct.pack("<B", value))

    def uint32(self, *values: int) -> None:
        """Write 32-bit numbers."""
        self._align(4)
        self._append(struct.pack(f"<{len(values)}I", *values))

    def float64s(self, numbers: Array) -> None:
        """Write 64-bit floats."""
        self._align(8)
        self._append(numbers.astype("<f8").tobytes())

    def string(self, text: str) -> None:
        """Write a string."""
        self.byte_sequence(text.encode() + b"\x00")

    def byte_sequence(self, data: BytesLike) -> None:
        """Write a sequence of bytes. An array is not copied before `to_bytes`."""
        # The types of Python 3.11 do not have that an array is a buffer.
        view = memoryview(cast(bytes, data)).cast("B")
        self.uint32(len(view))
        self._append(view)

    def header(self, stamp_s: float, frame_id: str) -> None:
        """Write a ``std_msgs/msg/Header``.

        Raises:
            ValueError: The stamp does not fit.
        """
        self._align(4)
        self._append(_STAMP.pack(*split_stamp(stamp_s)))
        self.string(frame_id)

    def to_bytes(self) -> bytes:
        """Return the message."""
        return b"".join(self._parts)

    def _align(self, size: int) -> None:
        self._append(bytes(-self._length % size))

    def _append(self, data: bytes | memoryview) -> None:
        self._parts.append(data)
        self._length += len(data)


class CdrReader:
    """Reads the fields of one message, in order.

    Its methods raise ValueError or `struct.error` if the message is too short or malformed;
    `reading` turns them into one ValueError.
    """

    def __init__(self, payload: BytesLike) -> None:
        """Start to read.

        Raises:
            ValueError: It is not little-endian CDR.
        """
        view = memoryview(cast(bytes, payload))
        if view[:4] != CDR_HEADER:
            raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
        self._body = view[4:]
        self._offset = 0

    def uint8(self) -> int:
        """Read an 8-bit number."""
        return int(self._unpack("<B", 1)[0])

    def uint32(self) -> int:
        """Read a 32-bit number."""
        return int(self._unpack("<I", 4)[0])

    def float64s(self, count: int) -> Array:
        """Read 64-bit floats."""
        self._offset += -self._offset % 8
        numbers = np.frombuffer(self._take(8 * count), "<f8")
        return numbers.astype(np.float64)

    def string(self) -> str:
        """Read a string."""
        return self.byte_sequence().tobytes().rstrip(b"\x00").decode()

    def byte_sequence(self) -> NDArray[np.uint8]:
        """Read a sequence of bytes, without a copy: a read-only array."""
        return np.frombuffer(self._take(self.uint32()), np.uint8)

    def header(self) -> tuple[float, str]:
        """Read a ``std_msgs/msg/Header``: stamp in seconds, frame."""
        sec, nanosec = self._unpack("<iI", 4)
        return sec + nanosec * 1e-9, self.string()

    def _unpack(self, layout: str, alignment: int) -> tuple[Any, ...]:
        self._offset += -self._offset % alignment
        return struct.unpack(layout, self._take(struct.calcsize(layout)))

    def _take(self, count: int) -> memoryview:
        taken = self._body[self._offset : self._offset + count]
        if len(taken) < count:
            raise ValueError(f"it ends after {len(self._body) + 4} bytes")
        self._offset += count
        return taken


STRING_SCHEMA = "std_msgs/msg/String"


def encode_string(text: str) -> bytes:
    """Encode a ``std_msgs/msg/String`` as CDR."""
    writer = CdrWriter()
    writer.string(text)
    return writer.to_bytes()


@contextmanager
def reading(payload: BytesLike, schema: str) -> Iterator[CdrReader]:
    """Read a message in the block.

    Args:
        payload: The message.
        schema: Its type, for the error.

    Raises:
        ValueError: The bytes are not such a message, in little-endian CDR.
    """
    reader = CdrReader(payload)
    try:
        yield reader
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"not a {schema} message: {error}") from error


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


ODOMETRY_SCHEMA = "nav_msgs/msg/Odometry"
TRANSFORM_SCHEMA = "geometry_msgs/msg/TransformStamped"
TRANSFORMS_SCHEMA = "tf2_msgs/msg/TFMessage"
# position 3, quaternion 4, covariance 36, twist 6, covariance 36
_ODOMETRY_NUMBERS = 85
# translation 3, quaternion 4
_TRANSFORM_NUMBERS = 7


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
    writer = CdrWriter()
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(numbers)
    return writer.to_bytes()


def decode_odometry(payload: BytesLike) -> OdometryMessage:
    """Decode a message from `encode_odometry` or any ROS 2 node.

    Raises:
        ValueError: The bytes are not a little-endian Odometry message.
    """
    with reading(payload, ODOMETRY_SCHEMA) as reader:
        stamp_s, frame_id = reader.header()
        child_frame_id = reader.string()
        numbers = reader.float64s(_ODOMETRY_NUMBERS)
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
    writer = CdrWriter()
    _write_transform(writer, message)
    return writer.to_bytes()


def encode_transforms(messages: Sequence[TransformMessage]) -> bytes:
    """Encode transforms as one ``TFMessage``. Raises as `encode_transform`."""
    writer = CdrWriter()
    writer.uint32(len(messages))
    for message in messages:
        _write_transform(writer, message)
    return writer.to_bytes()


def decode_transform(payload: BytesLike) -> TransformMessage:
    """Decode a message from `encode_transform` or any ROS 2 node.

    Raises:
        ValueError: The bytes are not a little-endian TransformStamped message.
    """
    with reading(payload, TRANSFORM_SCHEMA) as reader:
        return _read_transform(reader)


def _write_transform(writer: CdrWriter, message: TransformMessage) -> None:
    if not np.all(np.isfinite(message.T_frame_child)):
        raise ValueError(f"transform at {message.stamp_s} s has a number that is not finite")
    writer.header(message.stamp_s, message.frame_id)
    writer.string(message.child_frame_id)
    writer.float64s(np.concatenate([message.translation_m, message.quaternion_xyzw]))


def _read_transform(reader: CdrReader) -> TransformMessage:
    stamp_s, frame_id = reader.header()
    child_frame_id = reader.string()
    numbers = reader.float64s(_TRANSFORM_NUMBERS)
    T_frame_child = transform_from_pose(numbers[:3], numbers[3:])
    return TransformMessage(stamp_s, frame_id, child_frame_id, T_frame_child)

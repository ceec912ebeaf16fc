"""Transforms for /tf, from the bytes of the messages that hold them."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

# CDR: the first four bytes say that what follows is little endian.
_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_STAMP_BYTES = 8
# Translation x y z and quaternion x y z w, float64.
_POSE_BYTES = 56


@dataclass(frozen=True)
class Transform:
    """A transform in the encoding of CDR.

    Attributes:
        stamp: Seconds (int32) and nanoseconds (uint32).
        frame_id: Name of the parent frame, UTF-8.
        child_frame_id: Name of the child frame, UTF-8.
        pose: Translation (meters) and quaternion x y z w: 7 float64.
    """

    stamp: bytes
    frame_id: bytes
    child_frame_id: bytes
    pose: bytes

    def at(self, stamp: bytes) -> "Transform":
        """Return the same transform with another stamp."""
        return replace(self, stamp=stamp)


def stamp_of(message: bytes) -> bytes:
    """Return the stamp of a message that begins with a header, as its 8 bytes."""
    return message[4 : 4 + _STAMP_BYTES]


def read_transform(message: bytes) -> Transform:
    """Read the transform of a ``nav_msgs/Odometry`` or ``geometry_msgs/TransformStamped``.

    Both begin with header, child frame and pose.

    Raises:
        ValueError: It is not such a message in little-endian CDR.
    """
    if message[:4] != _LITTLE_ENDIAN:
        raise ValueError("the message is not little-endian CDR")
    body = message[4:]
    frame_id, end = _read_string(body, _STAMP_BYTES)
    child_frame_id, end = _read_string(body, _align(end, 4))
    begin = _align(end, 8)
    pose = body[begin : begin + _POSE_BYTES]
    if len(pose) < _POSE_BYTES:
        raise ValueError("the message is too short")
    return Transform(body[:_STAMP_BYTES], frame_id, child_frame_id, pose)


def encode_transforms(transforms: Sequence[Transform]) -> bytes:
    """Encode a ``tf2_msgs/TFMessage``."""
    body = bytearray(struct.pack("<I", len(transforms)))
    for transform in transforms:
        _pad(body, 4)
        body += transform.stamp
        for name in (transform.frame_id, transform.child_frame_id):
            _pad(body, 4)
            body += struct.pack("<I", len(name) + 1) + name + b"\0"
        _pad(body, 8)
        body += transform.pose
    return _LITTLE_ENDIAN + bytes(body)


def _read_string(body: bytes, begin: int) -> tuple[bytes, int]:
    """Return a string without its final zero, and where it ends."""
    if begin + 4 > len(body):
        raise ValueError("the message is too short")
    (length,) = struct.unpack_from("<I", body, begin)
    end = begin + 4 + length
    if length < 1 or end > len(body):
        raise ValueError("the message has a name of a wrong length")
    return body[begin + 4 : end - 1], end


def _align(offset: int, size: int) -> int:
    return -(-offset // size) * size


def _pad(body: bytearray, size: int) -> None:
    body += bytes(_align(len(body), size) - len(body))

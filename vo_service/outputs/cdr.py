"""ROS 2's ``nav_msgs/msg/Odometry`` and ``tf2_msgs/msg/TFMessage`` as plain CDR bytes, without ROS.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the message's fields in order, each
aligned to its own size counted from the end of the header (OMG DDS-XTypes, "plain CDR").
"""

import math
import struct
from dataclasses import dataclass

import numpy as np

from drivers.geometry import Array, quaternion_from_rotation, transform_from_pose

SCHEMA = "nav_msgs/msg/Odometry"

_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")
# position 3, quaternion 4, covariance 36, twist 6, covariance 36
_NUMBERS = 85


@dataclass(frozen=True)
class OdometryMessage:
    """One odometry message.

    stamp_s           instant of the pose
    frame_id          the frame that the pose is in
    child_frame_id    the frame that moves; the twist is in its axes
    T_frame_child     4x4 pose
    pose_covariance   6x6, order x y z rx ry rz, axes of `frame_id`
    twist             (6,) m/s and rad/s
    twist_covariance  6x6
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
        """(3,) where the child frame is."""
        position: Array = self.T_frame_child[:3, 3]
        return position

    @property
    def quaternion_xyzw(self) -> Array:
        """(4,) how the child frame is turned."""
        return quaternion_from_rotation(self.T_frame_child[:3, :3])


def encode_odometry(message: OdometryMessage) -> bytes:
    """CDR bytes of a message.

    Raises ValueError if a number is not finite or the stamp does not fit: such a message must
    never leave.
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
        raise ValueError(f"odometry at {message.stamp_s} s holds a number that is not finite")
    body = _STAMP.pack(*split_stamp(message.stamp_s))
    body = _append_string(body, message.frame_id)
    body = _append_string(body, message.child_frame_id)
    return _HEADER + _aligned(body, 8) + numbers.astype("<f8").tobytes()


def decode_odometry(payload: bytes) -> OdometryMessage:
    """Read what `encode_odometry` (or any ROS 2 node) wrote.

    Raises ValueError if the bytes are not a little-endian Odometry message.
    """
    if payload[:4] != _HEADER:
        raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
    body = payload[4:]
    try:
        sec, nanosec = _STAMP.unpack_from(body)
        frame_id, offset = _read_string(body, _STAMP.size)
        child_frame_id, offset = _read_string(body, offset)
        numbers = np.frombuffer(body, "<f8", _NUMBERS, _align(offset, 8)).astype(np.float64)
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"not a {SCHEMA} message: {error}") from error
    return OdometryMessage(
        stamp_s=sec + nanosec * 1e-9,
        frame_id=frame_id,
        child_frame_id=child_frame_id,
        T_frame_child=transform_from_pose(numbers[:3], numbers[3:7]),
        pose_covariance=numbers[7:43].reshape(6, 6),
        twist=numbers[43:49],
        twist_covariance=numbers[49:85].reshape(6, 6),
    )


def encode_transform(
    stamp_s: float, frame_id: str, child_frame_id: str, T_frame_child: Array
) -> bytes:
    """CDR bytes of a ``tf2_msgs/msg/TFMessage`` with one transform, 4x4.

    Raises ValueError as `encode_odometry` does.
    """
    quaternion_xyzw = quaternion_from_rotation(T_frame_child[:3, :3])
    numbers = np.concatenate([T_frame_child[:3, 3], quaternion_xyzw])
    if not np.all(np.isfinite(numbers)):
        raise ValueError(f"transform at {stamp_s} s holds a number that is not finite")
    body = _LENGTH.pack(1) + _STAMP.pack(*split_stamp(stamp_s))
    body = _append_string(body, frame_id)
    body = _append_string(body, child_frame_id)
    return _HEADER + _aligned(body, 8) + numbers.astype("<f8").tobytes()


def split_stamp(stamp_s: float) -> tuple[int, int]:
    """Whole seconds, rounded down, and the nanoseconds (0 to 999 999 999) that follow.

    Raises ValueError if the seconds do not fit ROS 2's 32 signed bits (they end in 2038).
    """
    if not math.isfinite(stamp_s):
        raise ValueError(f"stamp {stamp_s} is not a time")
    sec = math.floor(stamp_s)
    # The subtraction is exact, so this is the nearest nanosecond; it may round up to a second.
    carry, nanosec = divmod(round((stamp_s - sec) * 1e9), 1_000_000_000)
    sec += carry
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"stamp {stamp_s} s does not fit the 32 bits that ROS 2 has for seconds")
    return sec, nanosec


def _align(offset: int, size: int) -> int:
    return offset + -offset % size


def _aligned(body: bytes, size: int) -> bytes:
    return body.ljust(_align(len(body), size), b"\x00")


def _append_string(body: bytes, text: str) -> bytes:
    encoded = text.encode() + b"\x00"
    return _aligned(body, 4) + _LENGTH.pack(len(encoded)) + encoded


def _read_string(body: bytes, offset: int) -> tuple[str, int]:
    start = _align(offset, 4) + _LENGTH.size
    (length,) = _LENGTH.unpack_from(body, start - _LENGTH.size)
    if start + length > len(body):
        raise ValueError("a string is longer than the message")
    return body[start : start + length].rstrip(b"\x00").decode(), start + length

"""What ROS 2's messages are made of, as plain CDR bytes.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the message's fields in order, each
aligned to its own size counted from the end of the header (OMG DDS-XTypes, "plain CDR").
"""

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from drivers.core.geometry import Array

CDR_HEADER = b"\x00\x01\x00\x00"

_STAMP = struct.Struct("<iI")
_LENGTH = struct.Struct("<I")


def append_length(body: bytes, count: int) -> bytes:
    """Go on with how many items follow."""
    return _pad_to(body, 4) + _LENGTH.pack(count)


def append_frames(body: bytes, stamp_s: float, frame_id: str, child_frame_id: str) -> bytes:
    """Go on with a ``std_msgs/msg/Header`` and the name of the frame that moves.

    Raises ValueError if the stamp does not fit.
    """
    body = _pad_to(body, 4) + _STAMP.pack(*split_stamp(stamp_s))
    return _append_string(_append_string(body, frame_id), child_frame_id)


def append_numbers(body: bytes, numbers: Array) -> bytes:
    """Go on with 64-bit numbers."""
    return _pad_to(body, 8) + numbers.astype("<f8").tobytes()


@contextmanager
def reraise_as_value_error(schema: str) -> Iterator[None]:
    """While a message is taken apart: whatever is wrong with it is a ValueError that names it."""
    try:
        yield
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise ValueError(f"not a {schema} message: {error}") from error


def strip_header(payload: bytes) -> bytes:
    """What follows the header. Raises ValueError if that is another."""
    if payload[:4] != CDR_HEADER:
        raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
    return payload[4:]


def read_frames(body: bytes) -> tuple[float, str, str, int]:
    """Stamp, frame and child frame at the beginning of a message, and the offset after them.

    Raises what `reading` turns into a ValueError.
    """
    sec, nanosec = _STAMP.unpack_from(body)
    frame_id, offset = _read_string(body, _STAMP.size)
    child_frame_id, offset = _read_string(body, offset)
    return sec + nanosec * 1e-9, frame_id, child_frame_id, offset


def read_numbers(body: bytes, offset: int, count: int) -> Array:
    """64-bit numbers after an offset. Raises ValueError if there are fewer."""
    return np.frombuffer(body, "<f8", count, _aligned_offset(offset, 8)).astype(np.float64)


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

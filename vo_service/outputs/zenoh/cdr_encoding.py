"""Plain CDR encoding of the parts of ROS 2's messages.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the fields in order. Each field is
aligned to its own size, counted from the end of the header (OMG DDS-XTypes, "plain CDR").
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
    """Append the number of items that follow."""
    return _pad_to(body, 4) + _LENGTH.pack(count)


def append_frames(body: bytes, stamp_s: float, frame_id: str, child_frame_id: str) -> bytes:
    """Append a ``std_msgs/msg/Header`` and the child frame's name.

    Raises:
        ValueError: the stamp does not fit.
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
    """Remove the header. Raises ValueError if it is not little-endian CDR."""
    if payload[:4] != CDR_HEADER:
        raise ValueError("not little-endian CDR: the first four bytes are not 00 01 00 00")
    return payload[4:]


def read_frames(body: bytes) -> tuple[float, str, str, int]:
    """Read the header and child frame at the start of a message.

    Returns:
        Stamp in seconds, frame, child frame, and the offset after them.

    Raises:
        Exception: the errors that `reraise_as_value_error` handles.
    """
    sec, nanosec = _STAMP.unpack_from(body)
    frame_id, offset = _read_string(body, _STAMP.size)
    child_frame_id, offset = _read_string(body, offset)
    return sec + nanosec * 1e-9, frame_id, child_frame_id, offset


def read_numbers(body: bytes, offset: int, count: int) -> Array:
    """Read `count` 64-bit floats after an offset. Raises ValueError if there are fewer."""
    return np.frombuffer(body, "<f8", count, _aligned_offset(offset, 8)).astype(np.float64)


def split_stamp(stamp_s: float) -> tuple[int, int]:
    """Split a stamp into whole seconds, rounded down, and nanoseconds (0 to 999 999 999).

    Raises:
        ValueError: the seconds do not fit ROS 2's 32 signed bits (they end in 2038).
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

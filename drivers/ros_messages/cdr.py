"""ROS 2 messages in plain CDR: the writer, and what all messages share. Needs only numpy.

Layout: 4 bytes of header (``00 01 00 00``, little endian), then the fields in order. Each field is
aligned to its own size, counted from the end of the header (OMG DDS-XTypes, "plain CDR").
"""

import math
import struct
from decimal import Decimal
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from drivers.core.geometry import Array

CDR_HEADER = b"\x00\x01\x00\x00"
_STAMP = struct.Struct("<iI")
# Unix time in seconds; a decimal is written without rounding to a float.
StampSeconds = float | Decimal
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

    def float32s(self, numbers: NDArray[np.floating[Any]]) -> None:
        """Write 32-bit floats."""
        self._align(4)
        self._append(numbers.astype("<f4").tobytes())

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

    def time(self, stamp_s: StampSeconds) -> None:
        """Write a ``builtin_interfaces/msg/Time``. Raises ValueError."""
        self._align(4)
        self._append(_STAMP.pack(*split_stamp(stamp_s)))

    def header(self, stamp_s: StampSeconds, frame_id: str) -> None:
        """Write a ``std_msgs/msg/Header``. Raises ValueError."""
        self.time(stamp_s)
        self.string(frame_id)

    def to_bytes(self) -> bytes:
        """Return the message."""
        return b"".join(self._parts)

    def _align(self, size: int) -> None:
        self._append(bytes(-self._length % size))

    def _append(self, data: bytes | memoryview) -> None:
        self._parts.append(data)
        self._length += len(data)


STRING_SCHEMA = "std_msgs/msg/String"


def encode_string(text: str) -> bytes:
    """Encode a ``std_msgs/msg/String`` as CDR."""
    writer = CdrWriter()
    writer.string(text)
    return writer.to_bytes()


def split_stamp(stamp_s: StampSeconds) -> tuple[int, int]:
    """Split a stamp into whole seconds, rounded down, and nanoseconds (0 to 999 999 999).

    Raises:
        ValueError: The seconds do not fit ROS 2's 32 signed bits (they end in 2038).
    """
    if not math.isfinite(stamp_s):
        raise ValueError(f"stamp {stamp_s} is not a time")
    sec = math.floor(stamp_s)
    # The subtraction is exact, so this is the nearest nanosecond; it may round up to a second.
    carry, nanosec = divmod(round((stamp_s - sec) * 1_000_000_000), 1_000_000_000)
    sec += carry
    if not -(2**31) <= sec < 2**31:
        raise ValueError(f"stamp {stamp_s} s does not fit ROS 2's 32 bits for seconds")
    return sec, nanosec

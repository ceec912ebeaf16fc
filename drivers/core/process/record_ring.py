"""A ring of records in shared memory: one process writes, another reads.

The memory grows only as it is filled. A record is contiguous. The ring is filled from start to
end, lap after lap, and a new record replaces the oldest ones.

There are no locks. Before it overwrites, the writer publishes how far, one record ahead. The
reader copies a record first and checks afterwards whether it was still intact. So a writer that
is killed at any instant leaves records that are whole, or known to be overwritten.

The ring of a camera (`drivers.subprocess_camera.frame_ring`) is another one, because it promises
the opposite: it has few slots of one size, and its reader owns a slot while it copies. No frame is
torn, and a slow reader makes the camera wait (lockstep) or skips frames. This ring never waits for
a reader, and keeps seconds of packed frames of any length.
"""

import errno
import math
import mmap
import os
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


def create_shared_memory(name: str, size: int) -> int:
    """Create memory for processes that inherit its file descriptor.

    It is a file without a name, which exists as long as one process holds it. Memory that is never
    touched is not allocated.

    Args:
        name: For /proc.
        size: Bytes.

    Returns:
        The file descriptor.

    Raises:
        OSError: There is not enough memory.
    """
    fd = os.memfd_create(name)
    try:
        os.ftruncate(fd, size)
    except OSError:
        os.close(fd)
        raise
    return fd


# Number of records ever written, and the position up to which older records are overwritten.
# They are written as whole numbers: `struct` clears the bytes first, and a reader would see zeros.
_HEADER_DTYPE = np.dtype(np.uint64)
_HEADER_SIZE = 2 * _HEADER_DTYPE.itemsize
# Number and position of a record, and the lengths of its payload and of the metadata behind it.
_ENTRY = struct.Struct("<QQQQ")
# A position is lap * stride + offset. No lap is as long as the stride.
_LAP_STRIDE = 1 << 40
_ALIGNMENT_BYTES = 64
_GROWTH_BYTES = 1 << 20
# With more records per second than this the ring holds a shorter time.
MAX_RECORDS_PER_S = 60
# A lap lasts this much longer than the ring's duration, for the records being replaced.
_SPARE_S = 0.2


@dataclass(frozen=True)
class RecordRingMemory:
    """The shared memory of a ring; a process that inherits the file descriptor can read it."""

    fd: int
    entries: int


@dataclass(frozen=True)
class RingRecord:
    """A copy of one record."""

    payload: bytes
    metadata: bytes


class RecordRingWriter:
    """The writing end, which creates the ring. Not thread-safe.

    Args:
        name: Name of the memory file, for /proc.
        duration_s: How long records are kept, as far as `max_bytes` allows.
        max_bytes: Largest size of the records.

    Raises:
        OSError: The memory cannot be allocated.
    """

    def __init__(self, name: str, duration_s: float, max_bytes: int) -> None:
        self._duration_s = duration_s + _SPARE_S
        entries = math.ceil(self._duration_s * MAX_RECORDS_PER_S)
        self._data_offset = _find_data_offset(entries)
        self._max_bytes = max_bytes
        self._lap = self._offset = self._overwritten_until = 0
        self.record_count = 0  # ever written
        self.used_bytes = 0  # allocated for records so far
        self._lap_start_s = 0.0
        self.is_limited_by_bytes = False  # `max_bytes`, not `duration_s`, has ended the last lap
        memory_fd = create_shared_memory(name, self._data_offset + max_bytes)
        self.memory = RecordRingMemory(memory_fd, entries)
        try:
            os.posix_fallocate(self.memory.fd, 0, self._data_offset)
            self._map = mmap.mmap(self.memory.fd, self._data_offset + max_bytes)
        except (OSError, ValueError):
            os.close(self.memory.fd)
            raise
        self._header = np.frombuffer(self._map, _HEADER_DTYPE, 2)
        self._data = np.frombuffer(self._map, np.uint8, offset=self._data_offset)

    def reserve(self, max_bytes: int, time_s: float) -> NDArray[np.uint8]:
        """Return the buffer for the next record.

        Args:
            max_bytes: Largest size of the record, its metadata included.
            time_s: Time of the record, on the records' own clock.

        Raises:
            OSError: There is not enough memory.
        """
        if not self._has_room(max_bytes):
            self._start_lap(is_limited_by_bytes=True)
            if not self._has_room(max_bytes):
                raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        if self._offset == 0:
            self._lap_start_s = time_s
        self._mark_overwritten(self._offset + max_bytes)
        return self._data[self._offset : self._offset + max_bytes]

    def commit(self, length: int, metadata: bytes, max_bytes: int, time_s: float) -> None:
        """Add the record in the reserved buffer, and reserve the next one.

        Args:
            length: Number of payload bytes written to the start of the buffer.
            metadata: Stored behind the payload.
            max_bytes: Largest size of the next record.
            time_s: Time of the record, as for `reserve`.
        """
        end = self._offset + length + len(metadata)
        self._data[end - len(metadata) : end] = np.frombuffer(metadata, np.uint8)
        entry = _HEADER_SIZE + self.record_count % self.memory.entries * _ENTRY.size
        position = self._lap * _LAP_STRIDE + self._offset
        _ENTRY.pack_into(self._map, entry, self.record_count, position, length, len(metadata))
        self.record_count += 1
        self._offset = end + -end % _ALIGNMENT_BYTES
        # One record ahead, so that a reader knows long before the bytes change.
        is_full = not self._has_room(max_bytes)
        if is_full or abs(time_s - self._lap_start_s) > self._duration_s:
            self._start_lap(is_limited_by_bytes=is_full)
        self._mark_overwritten(self._offset + max_bytes)

    def close(self) -> None:
        """Release the memory; it stays mapped in readers."""
        del self._header, self._data
        self._map.close()
        os.close(self.memory.fd)

    def _start_lap(self, *, is_limited_by_bytes: bool) -> None:
        self._lap, self._offset, self.is_limited_by_bytes = self._lap + 1, 0, is_limited_by_bytes

    def _has_room(self, max_bytes: int) -> bool:
        """Whether a record fits behind the last one; allocates more memory if needed."""
        end = self._offset + max_bytes
        if end <= self.used_bytes:
            return True
        if end > self._max_bytes:
            return False
        more = min(self._max_bytes, max(end, self.used_bytes + _GROWTH_BYTES)) - self.used_bytes
        try:
            # Allocated explicitly: touching memory that is not available kills the process.
            os.posix_fallocate(self.memory.fd, self._data_offset + self.used_bytes, more)
        except OSError:
            return False
        self.used_bytes += more
        return True

    def _mark_overwritten(self, until_offset: int) -> None:
        self._overwritten_until = max(
            self._overwritten_until, self._lap * _LAP_STRIDE + until_offset
        )
        # In this order a reader that sees a record also sees what it overwrites.
        self._header[1] = self._overwritten_until
        self._header[0] = self.record_count


class RecordRingReader:
    """The reading end of a ring, in this process or another."""

    def __init__(self, memory: RecordRingMemory) -> None:
        self._memory = memory
        self._data_offset = _find_data_offset(memory.entries)
        self._map = mmap.mmap(memory.fd, 0, prot=mmap.PROT_READ)
        self._header = np.frombuffer(self._map, _HEADER_DTYPE, 2)

    @property
    def record_count(self) -> int:
        """The number of records ever written, which is the next record's number."""
        return int(self._header[0])

    @property
    def oldest_number(self) -> int:
        """The number of the oldest record that may still exist."""
        return max(0, self.record_count - self._memory.entries + 1)

    def read_record(self, number: int) -> RingRecord | None:
        """Copy a record; None if it has been overwritten."""
        return self._copy(number, is_whole=True)

    def read_metadata(self, number: int) -> bytes | None:
        """Copy a record's metadata; None if the record has been overwritten."""
        record = self._copy(number, is_whole=False)
        return None if record is None else record.metadata

    def close(self) -> None:
        """Release the memory."""
        del self._header
        self._map.close()

    def _copy(self, number: int, *, is_whole: bool) -> RingRecord | None:
        entry = _HEADER_SIZE + number % self._memory.entries * _ENTRY.size
        entry_number, position, length, metadata_length = _ENTRY.unpack_from(self._map, entry)
        begin = self._data_offset + position % _LAP_STRIDE
        middle = begin + length
        payload = self._map[begin:middle] if is_whole else b""
        metadata = self._map[middle : middle + metadata_length]
        count, overwritten_until = self._header.tolist()
        is_listed = entry_number == number < count < number + self._memory.entries
        is_intact = is_listed and overwritten_until <= position + _LAP_STRIDE
        return RingRecord(payload, metadata) if is_intact else None


def _find_data_offset(entries: int) -> int:
    """Return the offset of the first record: the first page behind header and table."""
    size = _HEADER_SIZE + entries * _ENTRY.size
    return size + -size % mmap.PAGESIZE

"""A ring of records in shared memory: one process writes, another reads, and it outlives both.

The memory comes from memfd_create: a file without a name, which is there as long as one process
holds it. It grows only as it is filled. A record lies in one piece; the ring is filled from its
beginning to its end, lap after lap, and a new record takes the place of the oldest ones.

Nobody waits for anybody. The writer says how far it will overwrite before it does, one record
ahead; the reader copies a record first and looks afterwards whether it was still whole. So a
writer that is killed at any instant leaves records that are whole, or known to be lost.
"""

import errno
import math
import mmap
import os
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# Records ever written, and the place up to which older records are given up.
_HEADER = struct.Struct("<QQ")
# Which record it is, where, how long its payload is, and the note that lies behind the payload.
_ENTRY = struct.Struct("<QQQQ")
# Places count on from lap to lap. No lap is as long as this, so one number tells lap and offset.
_LAP_STRIDE = 1 << 40
_ALIGNMENT_BYTES = 64
_GROWTH_BYTES = 1 << 20
# More records than this a second are not expected: they would shorten what the ring holds.
MAX_RECORDS_PER_S = 60
# A lap lasts this much longer than what the ring shall hold, for the records being replaced.
_SPARE_S = 0.2


@dataclass(frozen=True)
class RecordRingMemory:
    """What a reader in another process needs: the file descriptor, with the same number there."""

    fd: int
    entries: int


@dataclass(frozen=True)
class RingRecord:
    """A copy of one record."""

    payload: bytes
    metadata: bytes


class RecordRingWriter:
    """The end that makes the ring. Not safe to use from two threads at once."""

    def __init__(self, name: str, duration_s: float, max_bytes: int) -> None:
        """Holds what was written in the last `seconds`, or as much of it as `max_bytes` allow.

        Raises OSError if the memory cannot be had.
        """
        self._duration_s = duration_s + _SPARE_S
        entries = math.ceil(self._duration_s * MAX_RECORDS_PER_S)
        self._data_offset = _find_data_offset(entries)
        self._max_bytes = max_bytes
        self._allocated_bytes = self._lap = self._offset = self._count = self._overwritten_until = 0
        self._lap_start_s = 0.0
        self.is_limited_by_bytes = False  # the bytes, not the seconds, have ended the last lap
        self.memory = RecordRingMemory(os.memfd_create(name), entries)
        try:
            os.ftruncate(self.memory.fd, self._data_offset + max_bytes)
            os.posix_fallocate(self.memory.fd, 0, self._data_offset)
            self._map = mmap.mmap(self.memory.fd, self._data_offset + max_bytes)
        except (OSError, ValueError):
            os.close(self.memory.fd)
            raise
        self._data = np.frombuffer(self._map, np.uint8, offset=self._data_offset)

    @property
    def record_count(self) -> int:
        """Records ever written."""
        return self._count

    @property
    def used_bytes(self) -> int:
        """Memory that has been taken for records so far."""
        return self._allocated_bytes

    def reserve(self, max_bytes: int, time_s: float) -> NDArray[np.uint8]:
        """Room to write the next record of at most `bound` bytes, its note included.

        time_s  of the record, on the records' own clock

        Raises OSError if there is no memory for it.
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
        """Add what was written into the first `length` bytes of the room, with a note."""
        end = self._offset + length + len(metadata)
        self._data[end - len(metadata) : end] = np.frombuffer(metadata, np.uint8)
        entry = _HEADER.size + self._count % self.memory.entries * _ENTRY.size
        place = self._lap * _LAP_STRIDE + self._offset
        _ENTRY.pack_into(self._map, entry, self._count, place, length, len(metadata))
        self._count += 1
        self._offset = end + -end % _ALIGNMENT_BYTES
        # One record ahead, so that a reader knows long before the bytes change.
        is_full = not self._has_room(max_bytes)
        if is_full or abs(time_s - self._lap_start_s) > self._duration_s:
            self._start_lap(is_limited_by_bytes=is_full)
        self._mark_overwritten(self._offset + max_bytes)

    def close(self) -> None:
        """Release the memory; a reader keeps it for itself."""
        del self._data
        self._map.close()
        os.close(self.memory.fd)

    def _start_lap(self, *, is_limited_by_bytes: bool) -> None:
        self._lap, self._offset, self.is_limited_by_bytes = self._lap + 1, 0, is_limited_by_bytes

    def _has_room(self, max_bytes: int) -> bool:
        """Whether a record fits behind the last one; takes more memory for it if it must."""
        end = self._offset + max_bytes
        if end <= self._allocated_bytes:
            return True
        if end > self._max_bytes:
            return False
        more = (
            min(self._max_bytes, max(end, self._allocated_bytes + _GROWTH_BYTES))
            - self._allocated_bytes
        )
        try:
            # Asked for in words: memory that is only touched and cannot be had kills the process.
            os.posix_fallocate(self.memory.fd, self._data_offset + self._allocated_bytes, more)
        except OSError:
            return False
        self._allocated_bytes += more
        return True

    def _mark_overwritten(self, until_offset: int) -> None:
        self._overwritten_until = max(
            self._overwritten_until, self._lap * _LAP_STRIDE + until_offset
        )
        _HEADER.pack_into(self._map, 0, self._count, self._overwritten_until)


class RecordRingReader:
    """Looks into a ring, in this process or another."""

    def __init__(self, memory: RecordRingMemory) -> None:
        self._memory = memory
        self._data_offset = _find_data_offset(memory.entries)
        self._map = mmap.mmap(memory.fd, 0, prot=mmap.PROT_READ)

    @property
    def record_count(self) -> int:
        """Records ever written: the next one's number."""
        count: int = _HEADER.unpack_from(self._map)[0]
        return count

    @property
    def oldest_number(self) -> int:
        """Number of the oldest record that may still be there."""
        return max(0, self.record_count - self._memory.entries + 1)

    def read_record(self, number: int) -> RingRecord | None:
        """A copy of a record; None if it has been overwritten."""
        return self._copy(number, is_whole=True)

    def read_metadata(self, number: int) -> bytes | None:
        """A copy of a record's note; None if the record has been overwritten."""
        record = self._copy(number, is_whole=False)
        return None if record is None else record.metadata

    def close(self) -> None:
        """Let go of the memory."""
        self._map.close()

    def _copy(self, number: int, *, is_whole: bool) -> RingRecord | None:
        at = _HEADER.size + number % self._memory.entries * _ENTRY.size
        found, place, length, note_length = _ENTRY.unpack_from(self._map, at)
        begin = self._data_offset + place % _LAP_STRIDE
        middle = begin + length
        payload = self._map[begin:middle] if is_whole else b""
        note = self._map[middle : middle + note_length]
        written, given_up = _HEADER.unpack_from(self._map)
        is_listed = found == number < written < number + self._memory.entries
        is_intact = is_listed and given_up <= place + _LAP_STRIDE
        return RingRecord(payload, note) if is_intact else None


def _find_data_offset(entries: int) -> int:
    """Where records begin: behind the header and the table, on a page of its own."""
    size = _HEADER.size + entries * _ENTRY.size
    return size + -size % mmap.PAGESIZE

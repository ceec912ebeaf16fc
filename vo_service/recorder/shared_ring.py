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
_LAP = 1 << 40
_ALIGNED = 64
_GROWTH = 1 << 20
# More records than this a second are not expected: they would shorten what the ring holds.
MOST_PER_SECOND = 60
# A lap lasts this much longer than what the ring shall hold, for the records being replaced.
_SPARE_S = 0.2


@dataclass(frozen=True)
class RingMemory:
    """What a reader in another process needs: the file descriptor, with the same number there."""

    fd: int
    entries: int


@dataclass(frozen=True)
class Record:
    """A copy of one record."""

    payload: bytes
    note: bytes


class RingWriter:
    """The end that makes the ring. Not safe to use from two threads at once."""

    def __init__(self, name: str, seconds: float, most_bytes: int) -> None:
        """Holds what was written in the last `seconds`, or as much of it as `most_bytes` allow.

        Raises OSError if the memory cannot be had.
        """
        self._seconds = seconds + _SPARE_S
        entries = math.ceil(self._seconds * MOST_PER_SECOND)
        self._begin = _data_begin(entries)
        self._most = most_bytes
        self._grown = self._lap = self._offset = self._count = self._given_up = 0
        self._lap_began_s = 0.0
        self.is_short = False  # the bytes, not the seconds, have ended the last lap
        self.memory = RingMemory(os.memfd_create(name), entries)
        try:
            os.ftruncate(self.memory.fd, self._begin + most_bytes)
            os.posix_fallocate(self.memory.fd, 0, self._begin)
            self._map = mmap.mmap(self.memory.fd, self._begin + most_bytes)
        except (OSError, ValueError):
            os.close(self.memory.fd)
            raise
        self._data = np.frombuffer(self._map, np.uint8, offset=self._begin)

    @property
    def count(self) -> int:
        """Records ever written."""
        return self._count

    @property
    def used_bytes(self) -> int:
        """Memory that has been taken for records so far."""
        return self._grown

    def reserve(self, bound: int, time_s: float) -> NDArray[np.uint8]:
        """Room to write the next record of at most `bound` bytes, its note included.

        time_s  of the record, on the records' own clock

        Raises OSError if there is no memory for it.
        """
        if not self._has_room(bound):
            self._begin_lap(is_short=True)
            if not self._has_room(bound):
                raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))
        if self._offset == 0:
            self._lap_began_s = time_s
        self._give_up(self._offset + bound)
        return self._data[self._offset : self._offset + bound]

    def commit(self, length: int, note: bytes, bound: int, time_s: float) -> None:
        """Add what was written into the first `length` bytes of the room, with a note."""
        end = self._offset + length + len(note)
        self._data[end - len(note) : end] = np.frombuffer(note, np.uint8)
        entry = _HEADER.size + self._count % self.memory.entries * _ENTRY.size
        place = self._lap * _LAP + self._offset
        _ENTRY.pack_into(self._map, entry, self._count, place, length, len(note))
        self._count += 1
        self._offset = end + -end % _ALIGNED
        # One record ahead, so that a reader knows long before the bytes change.
        is_full = not self._has_room(bound)
        if is_full or abs(time_s - self._lap_began_s) > self._seconds:
            self._begin_lap(is_short=is_full)
        self._give_up(self._offset + bound)

    def close(self) -> None:
        """Release the memory; a reader keeps it for itself."""
        del self._data
        self._map.close()
        os.close(self.memory.fd)

    def _begin_lap(self, *, is_short: bool) -> None:
        self._lap, self._offset, self.is_short = self._lap + 1, 0, is_short

    def _has_room(self, bound: int) -> bool:
        """Whether a record fits behind the last one; takes more memory for it if it must."""
        end = self._offset + bound
        if end <= self._grown:
            return True
        if end > self._most:
            return False
        more = min(self._most, max(end, self._grown + _GROWTH)) - self._grown
        try:
            # Asked for in words: memory that is only touched and cannot be had kills the process.
            os.posix_fallocate(self.memory.fd, self._begin + self._grown, more)
        except OSError:
            return False
        self._grown += more
        return True

    def _give_up(self, until: int) -> None:
        self._given_up = max(self._given_up, self._lap * _LAP + until)
        _HEADER.pack_into(self._map, 0, self._count, self._given_up)


class RingReader:
    """Looks into a ring, in this process or another."""

    def __init__(self, memory: RingMemory) -> None:
        self._memory = memory
        self._begin = _data_begin(memory.entries)
        self._map = mmap.mmap(memory.fd, 0, prot=mmap.PROT_READ)

    @property
    def count(self) -> int:
        """Records ever written: the next one's number."""
        count: int = _HEADER.unpack_from(self._map)[0]
        return count

    @property
    def oldest(self) -> int:
        """Number of the oldest record that may still be there."""
        return max(0, self.count - self._memory.entries + 1)

    def record(self, number: int) -> Record | None:
        """A copy of a record; None if it has been overwritten."""
        return self._copy(number, is_whole=True)

    def note(self, number: int) -> bytes | None:
        """A copy of a record's note; None if the record has been overwritten."""
        record = self._copy(number, is_whole=False)
        return None if record is None else record.note

    def close(self) -> None:
        """Let go of the memory."""
        self._map.close()

    def _copy(self, number: int, *, is_whole: bool) -> Record | None:
        at = _HEADER.size + number % self._memory.entries * _ENTRY.size
        found, place, length, note_length = _ENTRY.unpack_from(self._map, at)
        begin = self._begin + place % _LAP
        middle = begin + length
        payload = self._map[begin:middle] if is_whole else b""
        note = self._map[middle : middle + note_length]
        written, given_up = _HEADER.unpack_from(self._map)
        is_listed = found == number < written < number + self._memory.entries
        is_intact = is_listed and given_up <= place + _LAP
        return Record(payload, note) if is_intact else None


def _data_begin(entries: int) -> int:
    """Where records begin: behind the header and the table, on a page of its own."""
    size = _HEADER.size + entries * _ENTRY.size
    return size + -size % mmap.PAGESIZE

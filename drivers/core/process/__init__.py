"""What the service and its worker processes exchange: messages, and a ring of records.

The ring is in shared memory: one process writes, another reads. The memory grows only as it is
filled. A record is contiguous. The ring is filled from start to end, lap after lap, and a new
record replaces the oldest ones.

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
import pickle
import struct
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.core import UserFacingError

_COUNT_BYTES = 2


@dataclass(frozen=True)
class Shutdown:
    """To the worker, as the last message: finish and end."""


@dataclass(frozen=True)
class Heartbeat:
    """From the worker: it is alive and receives messages. A subclass may add its status."""

    @property
    def activity(self) -> str:
        """What the worker is doing, for the message if it hangs; "" = nothing special."""
        return ""

    @property
    def timeout_s(self) -> float | None:
        """How long until the next heartbeat at most; None = as the `WorkerSpec` says."""
        return None


@dataclass(frozen=True)
class LogMessage:
    """From the worker, for the log of the service."""

    level: int
    logger_name: str
    text: str


@dataclass(frozen=True)
class WorkerFailed:
    """From the worker, as the last message: an error that the user can understand ended it."""

    error: UserFacingError


def send_message(connection: "Connection[Any, Any]", message: object) -> None:
    """Send a message; its arrays are not copied into one buffer first.

    Raises:
        OSError: The other process has ended.
    """
    arrays: list[pickle.PickleBuffer] = []
    pickled = pickle.dumps(message, protocol=5, buffer_callback=arrays.append)
    connection.send_bytes(len(arrays).to_bytes(_COUNT_BYTES, "little") + pickled)
    for array in arrays:
        connection.send_bytes(array.raw())


def receive_message(connection: "Connection[Any, Any]") -> Any:
    """Wait for the next message.

    Raises:
        EOFError, OSError: The other process has ended.
    """
    head = connection.recv_bytes()
    count = int.from_bytes(head[:_COUNT_BYTES], "little")
    # A bytearray, so that the arrays can be written to, as after any other way to send them.
    arrays = [bytearray(connection.recv_bytes()) for _ in range(count)]
    return pickle.loads(head[_COUNT_BYTES:], buffers=arrays)


# How long the service waits for the end of a process that finishes alone.
FINISHING_TIMEOUT_S = 1.5


@dataclass(frozen=True)
class WorkerSpec:
    """What a worker process runs, and its limits.

    Attributes:
        function: "MODULE:FUNCTION". The process calls it with its `ServiceConnection`.
        name: Name in the log.
        start_timeout_s: Longest time to the first heartbeat.
        heartbeat_timeout_s: Longest time between two heartbeats. After it the process is killed.
        exit_timeout_s: Longest time to end, when asked to or when the service has ended. After it
            the process is killed.
        finishes_alone: The service does not wait for the end of the process, which may still write
            data. It also prints to the service's stderr, since nobody may be left to log that.
        orphan_timeout_s: Longest time until a process whose native code holds the GIL is killed
            when the service has ended.
        nice: Added to its niceness: poses have priority if CPUs are scarce.
        oom_score_adj: How readily the kernel kills it when memory runs out: at most 1000.
        memory_mb: Its memory limit; 0 = none.
        memory_key: The configuration key of the memory limit, for the message.
    """

    function: str
    name: str
    start_timeout_s: float = 60.0
    heartbeat_timeout_s: float = 120.0
    exit_timeout_s: float = 1.5
    finishes_alone: bool = False
    orphan_timeout_s: float = 20.0
    nice: int = 0
    oom_score_adj: int | None = None
    memory_mb: int = 0
    memory_key: str = ""

    @property
    def closing_timeout_s(self) -> float:
        """How long the service waits for the end of the process."""
        return FINISHING_TIMEOUT_S if self.finishes_alone else self.exit_timeout_s


class WorkerConfig(Protocol):
    """What a worker is to do. It is sent to the process as a part of the first message."""

    @property
    def fds(self) -> tuple[int, ...]:
        """File descriptors that the process inherits, with the same numbers."""
        ...


@dataclass(frozen=True)
class StartWorker:
    """The first message to a worker process; see `WorkerSpec`."""

    spec: WorkerSpec
    config: WorkerConfig
    log_level: int


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
        self._allocated_bytes = self._lap = self._offset = self._count = self._overwritten_until = 0
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

    @property
    def record_count(self) -> int:
        """The number of records ever written."""
        return self._count

    @property
    def used_bytes(self) -> int:
        """The memory allocated for records so far."""
        return self._allocated_bytes

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
        entry = _HEADER_SIZE + self._count % self.memory.entries * _ENTRY.size
        position = self._lap * _LAP_STRIDE + self._offset
        _ENTRY.pack_into(self._map, entry, self._count, position, length, len(metadata))
        self._count += 1
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
        if end <= self._allocated_bytes:
            return True
        if end > self._max_bytes:
            return False
        more = (
            min(self._max_bytes, max(end, self._allocated_bytes + _GROWTH_BYTES))
            - self._allocated_bytes
        )
        try:
            # Allocated explicitly: touching memory that is not available kills the process.
            os.posix_fallocate(self.memory.fd, self._data_offset + self._allocated_bytes, more)
        except OSError:
            return False
        self._allocated_bytes += more
        return True

    def _mark_overwritten(self, until_offset: int) -> None:
        self._overwritten_until = max(
            self._overwritten_until, self._lap * _LAP_STRIDE + until_offset
        )
        # In this order a reader that sees a record also sees what it overwrites.
        self._header[1] = self._overwritten_until
        self._header[0] = self._count


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

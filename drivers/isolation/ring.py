"""A ring of whole frames between two processes: one writes, the other reads.

The memory comes from memfd_create: a file without a name. It needs no /dev/shm (which a hardened
systemd unit may hide, and where a killed process would leave its file behind), and it is gone when
the last process that holds it is.

Every slot has one owner at any time. The right to touch a slot is a token, one byte with its
number, that travels through two pipes: through `free` to the writer, through `filled` to the
reader. A pipe gives each byte to exactly one process, keeps their order, wakes who waits, and
makes what was written before the token went in visible to whoever takes it out. So a frame is never
read while it is written, whatever the two do and whenever one of them is killed: a writer that dies
takes the tokens in its hands with it, and `RingReader.reset` makes new ones.

The pace decides who waits for whom. Lockstep: the reader takes one frame at a time, and the
writer waits for a free slot, so nothing is lost. Realtime: the reader takes the newest frame and
gives the older ones back; a writer without a free slot takes the oldest unread frame back.
"""

import os
import select
import threading
import time
from contextlib import suppress
from dataclasses import dataclass

from drivers.camera import NoFrameYet, Pace, RgbdFrame
from drivers.isolation.slots import SLOT_BYTES, SLOTS, Slots

_END = SLOTS  # the token that says: no frame will follow
_ALL = bytes(range(SLOTS))


class RingEndedError(Exception):
    """No frame is left and none will follow."""


@dataclass(frozen=True)
class RingEnds:
    """The file descriptors that a writer in another process needs; the same numbers there."""

    memory: int
    free: int
    filled: int
    filled_to_reader: int

    @property
    def all(self) -> tuple[int, int, int, int]:
        """Every one of them."""
        return self.memory, self.free, self.filled, self.filled_to_reader


class RingReader:
    """The end that owns the ring. One thread takes; another may reset and finish it."""

    def __init__(self, pace: Pace) -> None:
        self._at_once = 1 if pace is Pace.LOCKSTEP else SLOTS + 1
        self._lock = threading.Lock()
        self._is_open = self._is_ended = self._is_granted = False
        self._expected = 0
        self.dropped = 0  # frames that were never taken, since `open`

    def open(self) -> None:
        """Make the ring. Nobody writes before `grant`, or the first `take`."""
        memory = os.memfd_create("camera-frames")
        os.ftruncate(memory, SLOTS * SLOT_BYTES)
        self._slots = Slots(memory)
        free, self._free_to_writer = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        filled, filled_to_reader = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self.ends = RingEnds(memory, free, filled, filled_to_reader)
        self._poll = _poll_on(filled)
        self._is_open, self._is_ended, self._is_granted = True, False, False
        self._expected = self.dropped = 0

    def grant(self) -> None:
        """Let the writer begin, if it has not been let yet."""
        with self._lock:
            if self._is_open and not self._is_granted:
                self._is_granted = True
                os.write(self._free_to_writer, _ALL)

    def reset(self) -> None:
        """Begin afresh, with every slot free, now that the writer is no more; `grant` it again."""
        with self._lock:
            if self._is_open:
                unread = _tokens(self.ends.filled, SLOTS)
                if unread:
                    self.dropped += self._slots.read(unread[-1])[0] + 1 - self._expected
                _tokens(self.ends.free, SLOTS)
                self._is_granted = False
                self._expected = 0

    def finish(self) -> None:
        """No frame will follow, as the writer is no more: `take` says so behind the last one."""
        with self._lock:
            if self._is_open:
                os.write(self.ends.filled_to_reader, bytes([_END]))

    def take(self, timeout_s: float) -> RgbdFrame:
        """Copy out the frame that is next at this pace.

        Raises NoFrameYet after `timeout_s`, RingEndedError if none is left and none will follow.
        """
        deadline_s = time.monotonic() + timeout_s
        self.grant()
        while True:
            frame = self._take_at_once()
            if frame is not None:
                return frame
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                raise NoFrameYet
            self._poll.poll(left_s * 1e3)

    def close(self) -> None:
        """Release everything. Safe to call twice."""
        with self._lock:
            if self._is_open:
                self._is_open = False
                self._slots.close()
                for fd in (*self.ends.all, self._free_to_writer):
                    os.close(fd)

    def _take_at_once(self) -> RgbdFrame | None:
        with self._lock:
            if not self._is_open or self._is_ended:
                raise RingEndedError
            tokens = _tokens(self.ends.filled, self._at_once)
            if _END in tokens:
                self._is_ended = True
                tokens = tokens.rstrip(bytes([_END]))
                if not tokens:
                    raise RingEndedError
            return self._copy_newest(tokens) if tokens else None

    def _copy_newest(self, tokens: bytes) -> RgbdFrame:
        try:
            ordinal, frame = self._slots.read(tokens[-1])
        finally:
            os.write(self._free_to_writer, tokens)
        self.dropped += ordinal - self._expected
        self._expected = ordinal + 1
        return frame


class RingWriter:
    """The other end, in the process that has the camera."""

    def __init__(self, ends: RingEnds, pace: Pace) -> None:
        self._slots = Slots(ends.memory)
        self._filled_to_reader = ends.filled_to_reader
        self._sources = (ends.free,) if pace is Pace.LOCKSTEP else (ends.free, ends.filled)
        self._poll = _poll_on(*self._sources)
        self._in_hand = b""
        self._ordinal = 0

    def acquire(self, timeout_s: float) -> bool:
        """Wait for a slot to write into; at once if there is one in hand."""
        deadline_s = time.monotonic() + timeout_s
        while not self._in_hand:
            self._in_hand = next(filter(None, (_tokens(fd, 1) for fd in self._sources)), b"")
            left_s = deadline_s - time.monotonic()
            if self._in_hand or left_s <= 0.0:
                break
            self._poll.poll(left_s * 1e3)
        return bool(self._in_hand)

    def put(self, frame: RgbdFrame) -> None:
        """Copy a frame into the slot in hand and pass it on."""
        self._slots.write(self._in_hand[0], self._ordinal, frame)
        os.write(self._filled_to_reader, self._in_hand)
        self._in_hand = b""
        self._ordinal += 1


def _tokens(fd: int, most: int) -> bytes:
    """The tokens waiting in a pipe, up to so many."""
    with suppress(BlockingIOError):
        return os.read(fd, most)
    return b""


def _poll_on(*fds: int) -> select.poll:
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN)
    return poll

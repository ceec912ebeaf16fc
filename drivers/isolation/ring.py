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

from drivers.camera import FrameTimeout, PlaybackMode, RgbdFrame
from drivers.isolation.slots import SLOT_BYTES, SLOT_COUNT, FrameSlots

_END_TOKEN = SLOT_COUNT  # the token that says: no frame will follow
_ALL_TOKENS = bytes(range(SLOT_COUNT))


class FrameRingEndedError(Exception):
    """No frame is left and none will follow."""


@dataclass(frozen=True)
class FrameRingFds:
    """The file descriptors that a writer in another process needs; the same numbers there."""

    memory_fd: int
    free_read_fd: int
    filled_read_fd: int
    filled_write_fd: int

    @property
    def all(self) -> tuple[int, int, int, int]:
        """Every one of them."""
        return self.memory_fd, self.free_read_fd, self.filled_read_fd, self.filled_write_fd


class FrameRingReader:
    """The end that owns the ring. One thread takes; another may reset and finish it."""

    def __init__(self, playback_mode: PlaybackMode) -> None:
        self._max_tokens = 1 if playback_mode is PlaybackMode.LOCKSTEP else SLOT_COUNT + 1
        self._lock = threading.Lock()
        self._is_open = self._is_ended = self._has_allowed_writes = False
        self._next_ordinal = 0
        self.dropped = 0  # frames that were never taken, since `open`

    def open(self) -> None:
        """Make the ring. Nobody writes before `grant`, or the first `take`."""
        memory = os.memfd_create("camera-frames")
        os.ftruncate(memory, SLOT_COUNT * SLOT_BYTES)
        self._slots = FrameSlots(memory)
        free, self._free_write_fd = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        filled, filled_to_reader = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self.fds = FrameRingFds(memory, free, filled, filled_to_reader)
        self._poll = _make_poll(filled)
        self._is_open, self._is_ended, self._has_allowed_writes = True, False, False
        self._next_ordinal = self.dropped = 0

    def allow_writes(self) -> None:
        """Let the writer begin, if it has not been let yet."""
        with self._lock:
            if self._is_open and not self._has_allowed_writes:
                self._has_allowed_writes = True
                os.write(self._free_write_fd, _ALL_TOKENS)

    def reset(self) -> None:
        """Begin afresh, with every slot free, now that the writer is no more; `grant` it again."""
        with self._lock:
            if self._is_open:
                unread = _read_tokens(self.fds.filled_read_fd, SLOT_COUNT)
                if unread:
                    self.dropped += self._slots.read(unread[-1])[0] + 1 - self._next_ordinal
                _read_tokens(self.fds.free_read_fd, SLOT_COUNT)
                self._has_allowed_writes = False
                self._next_ordinal = 0

    def finish(self) -> None:
        """No frame will follow, as the writer is no more: `take` says so behind the last one."""
        with self._lock:
            if self._is_open:
                os.write(self.fds.filled_write_fd, bytes([_END_TOKEN]))

    def get(self, timeout_s: float) -> RgbdFrame:
        """Copy out the frame that is next at this pace.

        Raises NoFrameYet after `timeout_s`, RingEndedError if none is left and none will follow.
        """
        deadline_s = time.monotonic() + timeout_s
        self.allow_writes()
        while True:
            frame = self._try_get()
            if frame is not None:
                return frame
            left_s = deadline_s - time.monotonic()
            if left_s <= 0.0:
                raise FrameTimeout
            self._poll.poll(left_s * 1e3)

    def close(self) -> None:
        """Release everything. Safe to call twice."""
        with self._lock:
            if self._is_open:
                self._is_open = False
                self._slots.close()
                for fd in (*self.fds.all, self._free_write_fd):
                    os.close(fd)

    def _try_get(self) -> RgbdFrame | None:
        with self._lock:
            if not self._is_open or self._is_ended:
                raise FrameRingEndedError
            tokens = _read_tokens(self.fds.filled_read_fd, self._max_tokens)
            if _END_TOKEN in tokens:
                self._is_ended = True
                tokens = tokens.rstrip(bytes([_END_TOKEN]))
                if not tokens:
                    raise FrameRingEndedError
            return self._copy_newest(tokens) if tokens else None

    def _copy_newest(self, tokens: bytes) -> RgbdFrame:
        try:
            ordinal, frame = self._slots.read(tokens[-1])
        finally:
            os.write(self._free_write_fd, tokens)
        self.dropped += ordinal - self._next_ordinal
        self._next_ordinal = ordinal + 1
        return frame


class FrameRingWriter:
    """The other end, in the process that has the camera."""

    def __init__(self, fds: FrameRingFds, playback_mode: PlaybackMode) -> None:
        self._slots = FrameSlots(fds.memory_fd)
        self._filled_write_fd = fds.filled_write_fd
        self._token_fds = (
            (fds.free_read_fd,)
            if playback_mode is PlaybackMode.LOCKSTEP
            else (fds.free_read_fd, fds.filled_read_fd)
        )
        self._poll = _make_poll(*self._token_fds)
        self._held_token = b""
        self._ordinal = 0

    def acquire(self, timeout_s: float) -> bool:
        """Wait for a slot to write into; at once if there is one in hand."""
        deadline_s = time.monotonic() + timeout_s
        while not self._held_token:
            self._held_token = next(
                filter(None, (_read_tokens(fd, 1) for fd in self._token_fds)), b""
            )
            left_s = deadline_s - time.monotonic()
            if self._held_token or left_s <= 0.0:
                break
            self._poll.poll(left_s * 1e3)
        return bool(self._held_token)

    def put(self, frame: RgbdFrame) -> None:
        """Copy a frame into the slot in hand and pass it on."""
        self._slots.write(self._held_token[0], self._ordinal, frame)
        os.write(self._filled_write_fd, self._held_token)
        self._held_token = b""
        self._ordinal += 1


def _read_tokens(fd: int, max_tokens: int) -> bytes:
    """The tokens waiting in a pipe, up to so many."""
    with suppress(BlockingIOError):
        return os.read(fd, max_tokens)
    return b""


def _make_poll(*fds: int) -> select.poll:
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN)
    return poll

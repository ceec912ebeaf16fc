"""Frames in shared memory, passed from the worker process to the service by tokens in pipes.

A token is the number of a slot. The writer takes a free token, fills the slot and passes the token
on; the reader copies the frame and returns the token. In realtime a writer without a free token
takes back the oldest filled one.
"""

import mmap
import os
import pickle
import select
import threading
import time
from contextlib import suppress
from dataclasses import dataclass, fields
from struct import Struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.camera import FrameTimeout, ImageArrays, PlaybackMode, RgbdFrame, new_images
from drivers.core import UserFacingError
from drivers.core.process.record_ring import create_shared_memory

SLOT_COUNT = 4
# Enough for 12 megapixels. Untouched memory is not allocated: 640x480 takes 1.5 MB per slot.
SLOT_BYTES = 64 * 2**20
# In front of a slot: width and height of its images, and the length of the pickled other fields.
_HEADER = Struct("=3Q")
_ALIGNMENT_BYTES = 64
_ImageAndPlace = tuple[NDArray[Any], NDArray[Any]]


class FrameSlots:
    """`SLOT_COUNT` frames in one block of memory. The ring controls the access to the slots."""

    def __init__(self, memory_fd: int) -> None:
        """Map the memory of SLOT_COUNT * SLOT_BYTES."""
        self._memory = mmap.mmap(memory_fd, SLOT_COUNT * SLOT_BYTES)

    @staticmethod
    def has_room(width: int, height: int) -> bool:
        """Whether images of this size fit into a slot."""
        return _fields_offset(width, height) <= SLOT_BYTES

    def images(self, slot: int, width: int, height: int) -> ImageArrays:
        """Return the arrays of the images in a slot."""
        depth_at = slot * SLOT_BYTES + _depth_offset(width, height)
        color = np.frombuffer(
            self._memory, np.uint8, 3 * width * height, slot * SLOT_BYTES + _ALIGNMENT_BYTES
        )
        depth = np.frombuffer(self._memory, np.uint16, width * height, depth_at)
        return color.reshape(height, width, 3), depth.reshape(height, width)

    def write(self, slot: int, ordinal: int, frame: RgbdFrame) -> None:
        """Write a frame into a slot; images that are there already are not copied.

        Raises:
            UserFacingError: The frame is too large.
        """
        width, height = frame.camera.width, frame.camera.height
        # Without the images, and without the values that are cached in the frame.
        values = {name: getattr(frame, name) for name in _FIELDS}
        pickled = pickle.dumps((ordinal, values), protocol=5)
        fields_at = _fields_offset(width, height)
        if fields_at + len(pickled) > SLOT_BYTES:
            raise UserFacingError(
                f"frames of {width}x{height} are too large for the shared memory; "
                "choose a smaller mode of the camera"
            )
        begin = slot * SLOT_BYTES
        in_slot = np.frombuffer(self._memory, np.uint8, SLOT_BYTES, begin)
        color, depth = self.images(slot, width, height)
        images: list[_ImageAndPlace] = [(frame.color_bgr, color), (frame.depth_raw, depth)]
        moved = [
            # One made in the slot for another size would be overwritten by the other one.
            (image.copy() if np.may_share_memory(image, in_slot) else image, place)
            for image, place in images
            if not _is_at(image, place)
        ]
        for image, place in moved:
            np.copyto(place, image)
        _HEADER.pack_into(self._memory, begin, width, height, len(pickled))
        self._memory[begin + fields_at : begin + fields_at + len(pickled)] = pickled

    def read(self, slot: int) -> tuple[int, RgbdFrame]:
        """Return the ordinal and a copy of the frame in a slot."""
        begin = slot * SLOT_BYTES
        width, height, length = _HEADER.unpack_from(self._memory, begin)
        fields_at = begin + _fields_offset(width, height)
        ordinal, values = pickle.loads(self._memory[fields_at : fields_at + length])
        color, depth = self.images(slot, width, height)
        return ordinal, RgbdFrame(color_bgr=color.copy(), depth_raw=depth.copy(), **values)

    def close(self) -> None:
        """Unmap the memory."""
        # After Ctrl-C in the middle of a copy, the traceback may still hold the images. The memory
        # is then unmapped when the traceback is deleted.
        with suppress(BufferError):
            self._memory.close()


_FIELDS = [each.name for each in fields(RgbdFrame) if each.name not in ("color_bgr", "depth_raw")]


def _is_at(image: NDArray[Any], place: NDArray[Any]) -> bool:
    return image.ctypes.data == place.ctypes.data and image.strides == place.strides


def _depth_offset(width: int, height: int) -> int:
    end = _ALIGNMENT_BYTES + 3 * width * height
    return end + -end % _ALIGNMENT_BYTES


def _fields_offset(width: int, height: int) -> int:
    return _depth_offset(width, height) + 2 * width * height


_END_TOKEN = SLOT_COUNT  # sent after the last frame
_ALL_TOKENS = bytes(range(SLOT_COUNT))


class FrameRingEndedError(Exception):
    """No frame is left, and none will follow."""


@dataclass(frozen=True)
class FrameRingFds:
    """The file descriptors of a writer; a process that inherits them has the same numbers."""

    memory_fd: int
    free_read_fd: int
    filled_read_fd: int
    filled_write_fd: int

    @property
    def all(self) -> tuple[int, int, int, int]:
        """All file descriptors."""
        return self.memory_fd, self.free_read_fd, self.filled_read_fd, self.filled_write_fd


class FrameRingReader:
    """The reading end, which owns the ring. One thread reads; another may reset and finish it."""

    def __init__(self, playback_mode: PlaybackMode) -> None:
        self._max_tokens = 1 if playback_mode is PlaybackMode.LOCKSTEP else SLOT_COUNT + 1
        self._lock = threading.Lock()
        self._is_open = self._is_ended = self._has_allowed_writes = False
        self._next_ordinal = 0
        self.dropped = 0  # frames that were never read

    def open(self) -> None:
        """Create the ring. The writer waits for `allow_writes` or the first `get`."""
        memory = create_shared_memory("camera-frames", SLOT_COUNT * SLOT_BYTES)
        self._slots = FrameSlots(memory)
        free, self._free_write_fd = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        filled, filled_to_reader = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
        self.fds = FrameRingFds(memory, free, filled, filled_to_reader)
        self._poll = _make_poll(filled)
        self._is_open, self._is_ended, self._has_allowed_writes = True, False, False
        self._next_ordinal = 0

    def allow_writes(self) -> None:
        """Allow the writer to start, if it is not allowed already."""
        with self._lock:
            if self._is_open and not self._has_allowed_writes:
                self._has_allowed_writes = True
                os.write(self._free_write_fd, _ALL_TOKENS)

    def reset(self) -> None:
        """Free all slots after the writer's process has ended; call `allow_writes` again."""
        with self._lock:
            if self._is_open:
                unread = _read_tokens(self.fds.filled_read_fd, SLOT_COUNT)
                if unread:
                    self.dropped += self._slots.read(unread[-1])[0] + 1 - self._next_ordinal
                _read_tokens(self.fds.free_read_fd, SLOT_COUNT)
                self._has_allowed_writes = False
                self._next_ordinal = 0

    def finish(self) -> None:
        """End the stream after the writer has ended: `get` raises after the last frame."""
        with self._lock:
            if self._is_open:
                os.write(self.fds.filled_write_fd, bytes([_END_TOKEN]))

    def get(self, timeout_s: float) -> RgbdFrame:
        """Copy the next frame (lockstep) or the newest one (realtime).

        Raises:
            FrameTimeout: No frame arrived within `timeout_s`.
            FrameRingEndedError: No frame is left, and none will follow.
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
    """The writing end, in the camera's process."""

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
        """Wait for a slot to write to; return at once if one is held already."""
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

    def make_images(self, width: int, height: int) -> ImageArrays:
        """Return the arrays in the held slot, or new ones: so the next frame is not copied."""
        if not self._held_token or not FrameSlots.has_room(width, height):
            return new_images(width, height)
        return self._slots.images(self._held_token[0], width, height)

    def put(self, frame: RgbdFrame) -> None:
        """Write a frame into the held slot and pass it on."""
        self._slots.write(self._held_token[0], self._ordinal, frame)
        os.write(self._filled_write_fd, self._held_token)
        self._held_token = b""
        self._ordinal += 1


def _read_tokens(fd: int, max_tokens: int) -> bytes:
    """Read the tokens that are in a pipe, at most `max_tokens`."""
    with suppress(BlockingIOError):
        return os.read(fd, max_tokens)
    return b""


def _make_poll(*fds: int) -> select.poll:
    poll = select.poll()
    for fd in fds:
        poll.register(fd, select.POLLIN)
    return poll

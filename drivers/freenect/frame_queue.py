"""The way of an image from libfreenect's callback to the reader: buffers, callback and queue."""

import ctypes
import threading
import time
import weakref
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.camera import FrameTimeout
from drivers.core.errors import CameraLostError
from drivers.freenect.libfreenect_log import StreamHealth
from drivers.time_sync import StampedPair, StampUnwrapper


@dataclass(frozen=True, eq=False, slots=True, weakref_slot=True)
class PooledImage:
    """One image in its buffer.

    Attributes:
        seq: Number of the image in its stream, lost ones included.
        receive_time_s: CLOCK_MONOTONIC when the host had received all of it.
        pixels: (480, 640, 3) uint8 RGB or (480, 640) uint16.
    """

    seq: int
    receive_time_s: float
    pixels: NDArray[Any]


ImagePair = StampedPair[PooledImage, PooledImage]


class FrameQueueClosedError(CameraLostError):
    """The queue is closed: the camera is not open."""

    def __init__(self) -> None:
        super().__init__("the camera is not open; open it first")


class FrameQueue(ABC):
    """A queue for one pair of images."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._pair: ImagePair | None = None
        self._end: Exception | None = None
        self.delivered = self.dropped = 0

    @abstractmethod
    def put(self, pair: ImagePair) -> None:
        """Add a pair.

        Raises:
            FrameQueueClosedError: After `close`.
        """

    def get(self, timeout_s: float) -> ImagePair:
        """Wait for a pair.

        Raises:
            FrameTimeout: No pair arrived within `timeout_s`.
            Exception: The exception given to `finish`, after the last pair.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._pair or self._end, timeout_s)
            pair, self._pair = self._pair, None
            if pair is None:
                raise self._end or FrameTimeout
            self.delivered += 1
            self._changed.notify_all()
            return pair

    def finish(self, exception: Exception) -> None:
        """End the stream: `get` raises `exception` after the last pair. The first call counts."""
        with self._changed:
            self._end = self._end or exception
            self._changed.notify_all()

    def close(self) -> None:
        """Discard the pair; further calls raise FrameQueueClosedError."""
        with self._changed:
            self._pair, self._end = None, FrameQueueClosedError()
            self._changed.notify_all()

    def _store(self, pair: ImagePair) -> None:
        if isinstance(self._end, FrameQueueClosedError):
            raise self._end
        self._pair = pair
        self._changed.notify_all()


class LatestFrameQueue(FrameQueue):
    """A queue in which a newer pair replaces one that was not read in time."""

    def put(self, pair: ImagePair) -> None:
        """Add a pair without waiting."""
        with self._changed:
            self.dropped += self._pair is not None
            self._store(pair)


class BlockingFrameQueue(FrameQueue):
    """A queue that delivers every pair: the source waits for the reader."""

    def put(self, pair: ImagePair) -> None:
        """Wait until the previous pair is read, then add a pair."""
        with self._changed:
            self._changed.wait_for(lambda: self._pair is None or self._end)
            self._store(pair)


# Pairing holds up to 4 images of a stream; one is queued, one read, one written, one spare.
POOL_SIZE = 8

ImageHandler = Callable[[float, PooledImage], None]


class BufferPool:
    """A pool of image buffers. A buffer is free again when its image is no longer referenced."""

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._buffers: list[NDArray[Any]] = [np.zeros(shape, dtype) for _ in range(POOL_SIZE)]
        self._image_refs: list[Callable[[], PooledImage | None]] = [lambda: None] * POOL_SIZE

    def copy_image(self, address: int, seq: int, receive_time_s: float) -> PooledImage:
        """Copy the pixels at `address` into a free buffer."""
        free = next(index for index, image in enumerate(self._image_refs) if image() is None)
        pixels = self._buffers[free]
        ctypes.memmove(pixels.ctypes.data, address, pixels.nbytes)
        image = PooledImage(seq, receive_time_s, pixels)
        self._image_refs[free] = weakref.ref(image)
        return image


class FrameCallback:
    """Receives one stream's images from libfreenect and passes on the complete ones."""

    def __init__(
        self,
        pool: BufferPool,
        stamp_unwrapper: StampUnwrapper,
        health: StreamHealth,
        on_image: ImageHandler,
    ) -> None:
        self._pool, self._stamp_unwrapper = pool, stamp_unwrapper
        self._health, self._on_image = health, on_image

    def handle_frame(self, address: int, stamp: int) -> None:
        """Copy an image. The callback must be short, as USB packets get lost after 32 ms."""
        receive_time_s = time.monotonic()
        is_whole = self._health.add_delivered(receive_time_s)
        device_s = self._stamp_unwrapper.unwrap_s(stamp)
        if is_whole:
            seq = self._health.images - 1
            self._on_image(device_s, self._pool.copy_image(address, seq, receive_time_s))

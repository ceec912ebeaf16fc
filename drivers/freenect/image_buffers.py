"""From libfreenect's callback to a queue: each image is copied into a buffer of a pool."""

import ctypes
import time
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.freenect import StreamHealth
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

"""One stream of images: the callback that copies them into slots."""

import ctypes
import time
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.freenect.frame_queue import PooledImage
from drivers.freenect.libfreenect_log import StreamHealth
from drivers.time_sync import StampUnwrapper

# Pairing keeps 4 images of a stream, one is ready, one is read, one is written; one to spare.
POOL_SIZE = 8

ImageHandler = Callable[[float, PooledImage], None]


class BufferPool:
    """Room for images, made once. A slot is free again when nobody has its image any more."""

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._buffers: list[NDArray[Any]] = [np.zeros(shape, dtype) for _ in range(POOL_SIZE)]
        self._image_refs: list[Callable[[], PooledImage | None]] = [lambda: None] * POOL_SIZE

    def copy_image(self, address: int, seq: int, receive_time_s: float) -> PooledImage:
        """An image with a copy of the pixels at `address`."""
        free = next(index for index, user in enumerate(self._image_refs) if user() is None)
        pixels = self._buffers[free]
        ctypes.memmove(pixels.ctypes.data, address, pixels.nbytes)
        image = PooledImage(seq, receive_time_s, pixels)
        self._image_refs[free] = weakref.ref(image)
        return image


class FrameCallback:
    """Takes one stream's images from libfreenect and passes on the whole ones."""

    def __init__(
        self,
        pool: BufferPool,
        stamp_unwrapper: StampUnwrapper,
        health: StreamHealth,
        on_image: ImageHandler,
    ) -> None:
        self._pool, self._stamp_unwrapper, self._health, self._on_image = (
            pool,
            stamp_unwrapper,
            health,
            on_image,
        )

    def handle_frame(self, address: int, stamp: int) -> None:
        """The callback: copy and go, for USB waits no longer than 32 ms."""
        receive_time_s = time.monotonic()
        is_whole = self._health.add_delivered(receive_time_s)
        device_s = self._stamp_unwrapper.unwrap_s(stamp)
        if is_whole:
            seq = self._health.images - 1
            self._on_image(device_s, self._pool.copy_image(address, seq, receive_time_s))

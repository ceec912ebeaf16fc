"""One stream of images: the callback that copies them into slots."""

import ctypes
import time
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from drivers.device_clock import DeviceClock
from drivers.freenect.log import StreamHealth
from drivers.freenect.mailbox import Image

# Pairing keeps 4 images of a stream, one is ready, one is read, one is written; one to spare.
SLOTS = 8

Deliver = Callable[[float, Image], None]


class Slots:
    """Room for images, made once. A slot is free again when nobody has its image any more."""

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._slots: list[NDArray[Any]] = [np.zeros(shape, dtype) for _ in range(SLOTS)]
        self._users: list[Callable[[], Image | None]] = [lambda: None] * SLOTS

    def copy(self, address: int, seq: int, arrival_s: float) -> Image:
        """An image with a copy of the pixels at `address`."""
        free = next(index for index, user in enumerate(self._users) if user() is None)
        pixels = self._slots[free]
        ctypes.memmove(pixels.ctypes.data, address, pixels.nbytes)
        image = Image(seq, arrival_s, pixels)
        self._users[free] = weakref.ref(image)
        return image


class StreamIntake:
    """Takes one stream's images from libfreenect and passes on the whole ones."""

    def __init__(
        self, slots: Slots, clock: DeviceClock, health: StreamHealth, deliver: Deliver
    ) -> None:
        self._slots, self._clock, self._health, self._deliver = slots, clock, health, deliver

    def take(self, address: int, stamp: int) -> None:
        """The callback: copy and go, for USB waits no longer than 32 ms."""
        arrival_s = time.monotonic()
        is_whole = self._health.delivered(arrival_s)
        device_s = self._clock.seconds(stamp)
        if is_whole:
            seq = self._health.images - 1
            self._deliver(device_s, self._slots.copy(address, seq, arrival_s))

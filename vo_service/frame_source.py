"""Frames for the loop: straight from the camera, or from one that may go and come back."""

import math
import threading
import time
from collections.abc import Iterable, Iterator
from itertools import count
from typing import Protocol

from drivers.camera import (
    NO_FRAME_WARNING_S,
    CameraState,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
)
from drivers.core.errors import CameraError

# The loop gets a turn at least this often, frame or no frame.
TICK_S = 0.25
# How many ticks to wait before a camera is opened again, at first and at most.
MIN_RETRY_TICKS, MAX_RETRY_TICKS = 1, 6


class FrameSource(Protocol):
    """Frames, one after another; None where a tick passed without one, for the reason given."""

    @property
    def reason(self) -> str:
        """Why there is no frame now; "" while there are frames."""
        ...

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until the source ends or `stop` is set."""
        ...


class SinglePassSource:
    """One pass through an open camera. Its errors reach the caller."""

    def __init__(self, camera: RgbdCamera) -> None:
        self._camera = camera
        self.reason = ""

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until the last frame."""
        last_s = time.monotonic()
        while not stop.is_set():
            try:
                frame = self._camera.read(TICK_S)
            except FrameTimeout:
                self.reason = self._no_frame_reason(time.monotonic() - last_s)
                yield None
            except EndOfStream:
                return
            else:
                last_s = time.monotonic()
                self.reason = ""
                yield frame

    def _no_frame_reason(self, quiet_s: float) -> str:
        status = self._camera.status
        is_streaming = status.state is CameraState.STREAMING
        if is_streaming and quiet_s <= NO_FRAME_WARNING_S:
            return ""  # else a camera that loses every other frame would come and go
        return status.no_frame_reason


class PacedSource(SinglePassSource):
    """One pass through a recording, every frame, no faster than it was recorded."""

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until the last frame. A frame that comes late delays those after it."""
        due_s, last_stamp_s = -math.inf, 0.0
        for frame in super().frames(stop):
            if frame is not None:
                due_s = max(due_s + frame.stamp_s - last_stamp_s, time.monotonic())
                last_stamp_s = frame.stamp_s
                stop.wait(due_s - time.monotonic())
            yield frame


class ReconnectingSource:
    """Opens the camera, and opens it again whenever it goes. Ends only when told to stop.

    Raises InputError from the first `open`: what the user named will not get better by waiting.
    """

    def __init__(self, camera: RgbdCamera) -> None:
        self._camera = camera
        self.reason = "camera not opened yet"

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until stopped; None while the camera is away."""
        retry = MIN_RETRY_TICKS
        while not stop.is_set():
            try:
                self._camera.open()
                plain = SinglePassSource(self._camera)
                for frame in plain.frames(stop):
                    self.reason = plain.reason
                    retry = MIN_RETRY_TICKS
                    yield frame
                self.reason = "the recording has ended"
                yield from _wait_ticks(count(), stop)
            except CameraError as error:
                self.reason = str(error)
            finally:
                self._camera.close()
            yield from _wait_ticks(range(retry), stop)
            retry = min(2 * retry, MAX_RETRY_TICKS)


def _wait_ticks(ticks: Iterable[int], stop: threading.Event) -> Iterator[None]:
    """Give the loop its turns while there is nothing to read."""
    for _ in ticks:
        if stop.is_set():
            return
        yield None
        stop.wait(TICK_S)

"""Frame sources: one pass through a camera's frames, or frames until the service stops."""

import math
import threading
import time
from collections.abc import Callable, Iterator

from drivers.camera import (
    NO_FRAME_WARNING_S,
    CameraState,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
)

RECORDING_ENDED = "the recording has ended"
# A source yields at least this often, with or without a frame.
TICK_S = 0.25


class FrameSource:
    """Frames of an open camera, in one pass; None after each tick without a frame.

    Attributes:
        reason: Reason why there is no frame; "" while there are frames.
    """

    def __init__(self, camera: RgbdCamera) -> None:
        self._camera = camera
        self.reason = ""

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until the last frame, or until `stop` is set.

        Raises:
            CameraError: If the camera fails.
        """
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
            return ""  # a single lost frame does not change the state
        return status.no_frame_reason


class PacedSource(FrameSource):
    """One pass through all frames of a recording, no faster than it was recorded."""

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until the last frame, or until `stop` is set. A late frame delays the next ones."""
        due_s, last_stamp_s = -math.inf, 0.0
        for frame in super().frames(stop):
            if frame is not None:
                due_s = max(due_s + frame.stamp_s - last_stamp_s, time.monotonic())
                last_stamp_s = frame.stamp_s
                stop.wait(due_s - time.monotonic())
            yield frame


class LiveSource(FrameSource):
    """A camera that comes and goes: the source opens it, and waits after its last frame.

    Args:
        camera: The camera; it reconnects by itself.
        prepare_frame: Is applied to each frame.
    """

    def __init__(
        self,
        camera: RgbdCamera,
        prepare_frame: Callable[[RgbdFrame], RgbdFrame] = lambda frame: frame,
    ) -> None:
        super().__init__(camera)
        self._prepare_frame = prepare_frame
        self.reason = "camera not opened yet"

    def frames(self, stop: threading.Event) -> Iterator[RgbdFrame | None]:
        """Yield until `stop` is set; None while the camera is disconnected.

        Raises:
            InputError: If the camera refuses its settings: waiting does not help.
        """
        try:
            self._camera.open()
            for frame in super().frames(stop):
                yield None if frame is None else self._prepare_frame(frame)
            self.reason = RECORDING_ENDED
            while not stop.is_set():
                yield None
                stop.wait(TICK_S)
        finally:
            self._camera.close()

"""Frames of a camera until the service stops, and the clock that publishes their stamps."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from drivers.camera import (
    NO_FRAME_WARNING_S,
    CameraState,
    Clock,
    EndOfStream,
    FrameTimeout,
    RgbdCamera,
    RgbdFrame,
)
from drivers.clock_jumps import MAX_STALE_FRAMES
from drivers.pacing import DelayingPacer

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
        pacer = DelayingPacer()
        for frame in super().frames(stop):
            if frame is not None:
                stop.wait(pacer.seconds_until_due(frame.stamp_s))
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


# A larger step of the wall clock than this means that it was set, not that NTP adjusted it.
MAX_CLOCK_STEP_S = 0.05


class RecordedClock:
    """Publishes a recording's stamps, plus a constant offset."""

    def __init__(self, offset_s: float = 0.0) -> None:
        self._offset_s = offset_s

    def published_s(self, stamp_s: float) -> float:
        """Add the offset to the stamp."""
        return stamp_s + self._offset_s

    def has_stepped(self) -> bool:
        """Return False: a recording has one clock."""
        return False


class LiveClock:
    """CLOCK_MONOTONIC plus its offset to CLOCK_REALTIME, measured at start and after a clock step.

    Between steps, published stamps advance as evenly as the camera's own.
    """

    def __init__(
        self,
        offset_s: float = 0.0,
        monotonic_s: Callable[[], float] = time.monotonic,
        realtime_s: Callable[[], float] = time.time,
    ) -> None:
        self._offset_s = offset_s
        self._monotonic_s = monotonic_s
        self._realtime_s = realtime_s
        self._realtime_offset_s = self._measure_realtime_offset_s()

    def published_s(self, stamp_s: float) -> float:
        """Convert a stamp on CLOCK_MONOTONIC to Unix time."""
        return stamp_s + self._realtime_offset_s + self._offset_s

    def has_stepped(self) -> bool:
        """Whether the wall clock was set by more than `MAX_CLOCK_STEP_S` since the last call."""
        epoch_s = self._measure_realtime_offset_s()
        if abs(epoch_s - self._realtime_offset_s) <= MAX_CLOCK_STEP_S:
            return False
        self._realtime_offset_s = epoch_s
        return True

    def _measure_realtime_offset_s(self) -> float:
        """CLOCK_REALTIME minus CLOCK_MONOTONIC: the fastest of three readings."""
        return min(self._read_clocks() for _ in range(3))[1]

    def _read_clocks(self) -> tuple[float, float]:
        """Duration of a reading (longer if the process is interrupted in it), and the offset."""
        before_s, realtime_s, after_s = self._monotonic_s(), self._realtime_s(), self._monotonic_s()
        return after_s - before_s, realtime_s - 0.5 * (before_s + after_s)


# Converts a frame's stamp to the published stamp, s, and tells when the published clock was set.
PublishClock = RecordedClock | LiveClock


def make_publish_clock(clock: Clock, offset_s: float) -> PublishClock:
    """Make the published clock for a camera's clock.

    Args:
        clock: Clock of the camera's stamps.
        offset_s: Added to every published stamp, s.
    """
    return LiveClock(offset_s) if clock is Clock.MONOTONIC else RecordedClock(offset_s)


@dataclass(frozen=True)
class TimestampCheck:
    """Result of the check of a stamp.

    Attributes:
        is_accepted: Whether to use the frame.
        is_restart: Whether the camera's clock has restarted at this frame.
    """

    is_accepted: bool
    is_restart: bool = False


class TimestampFilter:
    """Accepts only frames whose stamps increase.

    After `MAX_STALE_FRAMES` rejected frames in a row, the camera's clock counts as restarted.
    """

    def __init__(self) -> None:
        self._last_s = float("-inf")
        self._stale = 0

    def check(self, stamp_s: float) -> TimestampCheck:
        """Check the stamp of the next frame, s on the camera's clock."""
        if stamp_s > self._last_s:
            self._last_s, self._stale = stamp_s, 0
            return TimestampCheck(is_accepted=True)
        self._stale += 1
        if self._stale < MAX_STALE_FRAMES:
            return TimestampCheck(is_accepted=False)
        self._last_s, self._stale = stamp_s, 0
        return TimestampCheck(is_accepted=True, is_restart=True)

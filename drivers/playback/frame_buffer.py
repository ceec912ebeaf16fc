"""The buffer between the thread that decodes a recording and the reader of the camera."""

import threading
from collections import deque
from dataclasses import replace

from drivers.camera import CameraCounters, FrameTimeout, RgbdFrame
from drivers.core import CameraError
from drivers.pacing import Pacer

MAX_BUFFERED_FRAMES = 4
NOT_OPEN = "the recording is not open; use `with`, or call open()"
NO_COUNTS = CameraCounters()


class BufferClosedError(Exception):
    """The buffer is closed, so the decoding thread must end."""


class FrameBuffer:
    """At most `MAX_BUFFERED_FRAMES` decoded frames in order, from one thread to another.

    Playback starts when the first frame is read.

    Args:
        pacer: Decides when a frame is delivered, and which frames are dropped.
        earlier_counters: Totals of the buffers before.
    """

    def __init__(self, pacer: Pacer, earlier_counters: CameraCounters = NO_COUNTS) -> None:
        self._pacer = pacer
        self._changed = threading.Condition()
        self._frames: deque[RgbdFrame] = deque()
        self._end: Exception | None = None
        self._counters = earlier_counters

    def next_index(self, index: int) -> int:
        """Return the frame to decode, `index` or a later one: outdated ones are not decoded."""
        with self._changed:
            next_index = self._pacer.newest_due(index)
            self._counters += CameraCounters(dropped=next_index - index)
            return next_index

    def put(self, frame: RgbdFrame) -> None:
        """Add a frame; while the buffer is full, wait until the oldest is read or outdated.

        Raises:
            BufferClosedError: If the buffer is closed.
        """
        with self._changed:
            if self._end is not None:
                raise BufferClosedError
            self._frames.append(frame)
            self._changed.notify_all()
            self._drop_outdated()
            while self._end is None and len(self._frames) >= MAX_BUFFERED_FRAMES:
                self._changed.wait(self._pacer.seconds_until_replaced(self._frames[1].seq))
                self._drop_outdated()

    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait until a frame is due; it was received when it was due and decoded.

        Raises:
            FrameTimeout: No frame is ready within `timeout_s`.
            Exception: The exception given to `finish`, when no frame is left.
        """
        with self._changed:
            self._pacer.start()
            self._changed.notify_all()
            deadline_s = self._pacer.host.now_s() + timeout_s
            while True:
                self._drop_outdated()
                left_s = deadline_s - self._pacer.host.now_s()
                wait_s = left_s
                if self._frames:
                    due_in_s = self._pacer.seconds_until_due(self._frames[0].seq)
                    if due_in_s == 0.0:
                        return self._deliver_oldest()
                    wait_s = min(left_s, due_in_s)
                elif self._end:
                    raise self._end
                if left_s <= 0.0:
                    raise FrameTimeout
                self._changed.wait(wait_s)

    def count_skipped(self) -> None:
        """Count a frame that could not be decoded."""
        with self._changed:
            self._counters += CameraCounters(skipped=1)

    def finish(self, exception: Exception) -> None:
        """End the stream: after the last frame `get` raises `exception`."""
        with self._changed:
            self._end = self._end or exception
            self._changed.notify_all()

    def close(self) -> None:
        """Discard the frames and wake both threads."""
        with self._changed:
            self._frames.clear()
            self._end = CameraError(NOT_OPEN)
            self._changed.notify_all()

    @property
    def counters(self) -> CameraCounters:
        """Totals of delivered, dropped and skipped frames, with those of the buffers before."""
        with self._changed:
            return self._counters

    def _deliver_oldest(self) -> RgbdFrame:
        frame = self._frames.popleft()
        self._counters += CameraCounters(delivered=1)
        self._changed.notify_all()
        complete_s = self._pacer.receive_time_s(frame.seq)
        return replace(frame, receive_time_s=max(complete_s, frame.receive_time_s))

    def _drop_outdated(self) -> None:
        while len(self._frames) > 1 and not self._pacer.seconds_until_replaced(self._frames[1].seq):
            self._frames.popleft()
            self._counters += CameraCounters(dropped=1)

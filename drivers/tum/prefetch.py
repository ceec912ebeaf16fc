"""Between the thread that decodes and the one that reads: a few frames, and the pace."""

import math
import threading
import time
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

from drivers.camera import CameraCounters, FrameTimeout, RgbdFrame
from drivers.core.errors import CameraError

MAX_BUFFERED_FRAMES = 4


class BufferClosedError(Exception):
    """Tells the decoding thread that nobody reads any more."""


class FrameBuffer(ABC):
    """At most CAPACITY decoded frames, in order of time. One thread puts, another takes."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._frames: deque[RgbdFrame] = deque()
        self._end: Exception | None = None
        self._delivered = self._dropped = self._skipped = 0

    @abstractmethod
    def next_index(self, index: int) -> int:
        """Index of the frame to decode, now that those before `index` are done."""

    @abstractmethod
    def put(self, frame: RgbdFrame) -> None:
        """Add a frame and wait until there is room for another. Raises BufferClosedError."""

    @abstractmethod
    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for the frame that is next at this pace.

        Raises NoFrameYet after `timeout_s`, and what `finish` was given when no frame is left.
        """

    def count_skipped(self) -> None:
        """Count a frame that could not be decoded."""
        with self._changed:
            self._skipped += 1

    def finish(self, exception: Exception) -> None:
        """No frame will follow: `end` (EndOfStream or an error) is raised behind the last one."""
        with self._changed:
            self._end = self._end or exception
            self._changed.notify_all()

    def close(self) -> None:
        """Forget the frames and wake both threads."""
        with self._changed:
            self._frames.clear()
            self._end = CameraError("the recording is not open")
            self._changed.notify_all()

    @property
    def counters(self) -> CameraCounters:
        """What became of the frames so far."""
        with self._changed:
            return CameraCounters(self._delivered, self._dropped, self._skipped)

    def _append(self, frame: RgbdFrame) -> None:
        if self._end is not None:
            raise BufferClosedError
        self._frames.append(frame)
        self._changed.notify_all()

    def _deliver_oldest(self, receive_time_s: float) -> RgbdFrame:
        self._delivered += 1
        self._changed.notify_all()
        return replace(self._frames.popleft(), receive_time_s=receive_time_s)

    def _is_full(self) -> bool:
        return self._end is None and len(self._frames) >= MAX_BUFFERED_FRAMES


class LockstepBuffer(FrameBuffer):
    """Every frame, when the reader asks for it."""

    def next_index(self, index: int) -> int:
        """Each frame in turn."""
        return index

    def put(self, frame: RgbdFrame) -> None:
        """Add a frame and wait while the reader is behind."""
        with self._changed:
            self._append(frame)
            self._changed.wait_for(lambda: not self._is_full())

    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for the next frame; it arrives when it is asked for."""
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._end, timeout_s)
            if self._frames:
                return self._deliver_oldest(time.monotonic())
            raise self._end or FrameTimeout


class RealtimeBuffer(FrameBuffer):
    """Each frame when it is due, a newer one instead of it once that is due.

    `offsets_s` are the frames' stamps since the first; the recording starts to run when the first
    frame is asked for. A frame's `seq` is its index there.
    """

    def __init__(
        self, offsets_s: Sequence[float], clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__()
        self._offsets_s = offsets_s
        self._clock = clock
        self._start_s = math.inf

    def next_index(self, index: int) -> int:
        """Pass over frames that are out of date already: decoding them would be wasted."""
        with self._changed:
            newest_due = bisect_right(self._offsets_s, self._clock() - self._start_s) - 1
            wanted = max(index, newest_due)
            self._dropped += wanted - index
            return wanted

    def put(self, frame: RgbdFrame) -> None:
        """Add a frame; while there is no room, wait for the oldest to be read or out of date."""
        with self._changed:
            self._append(frame)
            self._drop_outdated()
            while self._is_full():
                self._changed.wait(self._seconds_until_due(self._frames[1]))
                self._drop_outdated()

    def get(self, timeout_s: float) -> RgbdFrame:
        """Wait for a frame to be due; it arrives when it is due, or decoded if that is later."""
        with self._changed:
            if self._start_s == math.inf:
                self._start_s = self._clock()
                self._changed.notify_all()
            deadline_s = self._clock() + timeout_s
            while True:
                self._drop_outdated()
                if self._frames and self._seconds_until_due(self._frames[0]) == 0.0:
                    due_s = self._due_s(self._frames[0])
                    return self._deliver_oldest(max(due_s, self._frames[0].receive_time_s))
                if not self._frames and self._end:
                    raise self._end
                left_s = deadline_s - self._clock()
                if left_s <= 0.0:
                    raise FrameTimeout
                due_in_s = self._seconds_until_due(self._frames[0]) if self._frames else left_s
                self._changed.wait(min(left_s, due_in_s))

    def _drop_outdated(self) -> None:
        while len(self._frames) > 1 and self._seconds_until_due(self._frames[1]) == 0.0:
            self._frames.popleft()
            self._dropped += 1

    def _due_s(self, frame: RgbdFrame) -> float:
        return self._start_s + self._offsets_s[frame.seq]

    def _seconds_until_due(self, frame: RgbdFrame) -> float:
        """Seconds until `frame` is due, as long as can be before the start."""
        return min(max(0.0, self._due_s(frame) - self._clock()), threading.TIMEOUT_MAX)

"""Render order: the next frame is the first that can be ready before the reader needs it."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable

from drivers.synthetic.rendered_sequence import RenderedSequence


class RenderSchedule:
    """Assigns the missing frames of a sequence, each once, to any number of threads.

    In lockstep (`rate_hz` 0) the reader waits, so frames are rendered in order. A live reader does
    not wait: frames that cannot be ready in time are rendered later.
    """

    def __init__(
        self,
        sequence: RenderedSequence,
        rate_hz: float,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._sequence = sequence
        self._rate_hz = rate_hz
        self._now_s = now_s
        self._lock = threading.Lock()
        self._urgent: deque[int] = deque()
        self._started_s: dict[int, float] = {}  # start times of the frames being rendered
        self._reader = (0, math.inf)  # index of the reader's next frame, and when it was reported
        self._render_s = 0.0  # duration of the last frame's rendering

    def set_reader_position(self, index: int) -> None:
        """Report the frame that the reader needs next."""
        self._reader = (index, self._now_s())

    def add_urgent(self, index: int) -> None:
        """Render this frame before all others."""
        self._urgent.append(index)

    def next_frame(self) -> int | None:
        """Take the frame to render now; None if none is missing."""
        with self._lock:
            now_s = self._now_s()
            index = self._select_next(now_s)
            if index is not None:
                self._started_s[index] = now_s
            return index

    def mark_rendered(self, index: int) -> None:
        """Report that a frame from `next_frame` has been written."""
        with self._lock:
            self._render_s = self._now_s() - self._started_s.pop(index)

    def _select_next(self, now_s: float) -> int | None:
        while self._urgent:
            index = self._urgent.popleft()
            if index not in self._started_s and not self._sequence.is_rendered(index):
                return index
        missing = [int(i) for i in self._sequence.missing_frames() if i not in self._started_s]
        first = self._first_feasible(now_s)
        return next((i for i in missing if i >= first), missing[0] if missing else None)

    def _first_feasible(self, now_s: float) -> int:
        """The first frame that can be ready before the reader needs it."""
        index, since_s = self._reader
        ahead_s = max(0.0, now_s - since_s) + self._render_s
        return min(index + int(ahead_s * self._rate_hz), self._sequence.files.count - 1)

"""Load of the real-time loop, from the cost of each frame."""

from collections import deque
from dataclasses import dataclass

# The load is a mean over this long, and over at least this many frames.
WINDOW_S, MIN_FRAMES = 2.0, 10
# Upper bound of one frame's load, in frame intervals: one slow frame is not overload.
MAX_FRAME_LOAD = 2.0
# After this long without frames (no camera, a pause), old measurements are discarded.
MAX_IDLE_S = 1.0


@dataclass(frozen=True)
class FrameCost:
    """Cost of one frame in the loop.

    Attributes:
        busy_s: wall time from the frame's arrival in the loop to the end of its processing.
        cpu_s: CPU time of the same.
        interval_s: the camera's frame interval; 0 while unknown.
        dropped: frames dropped since the start because the loop was late.
    """

    busy_s: float
    cpu_s: float
    interval_s: float
    dropped: int


@dataclass(frozen=True)
class _FrameLoad:
    """One frame's wall time and CPU time as shares of the frame interval.

    Attributes:
        was_late: frames before it were dropped.
    """

    at_s: float
    busy: float
    cpu: float
    was_late: bool


class LoadMeter:
    """Mean busy time over the last seconds, as a share of the frame interval.

    A mean, not a median: under a CPU quota most frames are fast and every third waits long.
    """

    def __init__(self) -> None:
        self._frames: deque[_FrameLoad] = deque()
        self._first_s: float | None = None
        self._last_s = 0.0
        self._dropped: int | None = None

    def add(self, load: FrameCost, now_s: float) -> None:
        """Add one frame whose processing ended at `now_s`."""
        if now_s - load.busy_s - self._last_s > MAX_IDLE_S:
            self.clear()
        self._last_s = now_s
        has_dropped = self._dropped is not None and load.dropped > self._dropped
        self._dropped = load.dropped
        if load.interval_s > 0.0:
            self._first_s = now_s if self._first_s is None else self._first_s
            share = min(load.busy_s / load.interval_s, MAX_FRAME_LOAD)
            # A drop means full load, however fast the other frames are.
            busy = max(share, 1.0) if has_dropped else share
            self._frames.append(_FrameLoad(now_s, busy, load.cpu_s / load.interval_s, has_dropped))
            self._drop_old(now_s)

    def _drop_old(self, now_s: float) -> None:
        while len(self._frames) > MIN_FRAMES and now_s - self._frames[0].at_s > WINDOW_S:
            self._frames.popleft()

    def clear(self) -> None:
        """Discard all measurements."""
        self._frames.clear()
        self._first_s = None

    @property
    def load(self) -> float | None:
        """1.0 = busy all the time; more = late. None until there are enough frames."""
        if self._first_s is None or self._last_s - self._first_s < WINDOW_S:
            return None
        if len(self._frames) < MIN_FRAMES:
            return None
        return sum(share.busy for share in self._frames) / len(self._frames)

    @property
    def late_frames(self) -> int:
        """Frames of the last seconds that follow a drop; one delay counts once."""
        return sum(share.was_late for share in self._frames)

    @property
    def is_starved_of_cpu(self) -> bool:
        """Whether most of the busy time was spent waiting for the CPU."""
        busy, cpu = (sum(getattr(s, name) for s in self._frames) for name in ("busy", "cpu"))
        return bool(cpu < 0.5 * busy)

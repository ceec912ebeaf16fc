"""How busy the loop is, from what each frame cost."""

from collections import deque
from dataclasses import dataclass

# The load is that of so long a time, and of so many frames at least.
WINDOW_S, MIN_FRAMES = 2.0, 10
# However long one frame took, it counts as this many intervals: a hiccup is no load.
MAX_FRAME_LOAD = 2.0
# After so long with nothing to do (no camera, a pause) the past says nothing any more.
MAX_IDLE_S = 1.0


@dataclass(frozen=True)
class FrameCost:
    """What one frame cost the loop.

    busy_s      from the frame's arrival in the loop until it was done with it, on the wall clock
    cpu_s       processor time of that
    interval_s  the camera's, from one frame to the next; 0 while that is not known
    dropped     frames dropped so far because the loop was late, since the start
    """

    busy_s: float
    cpu_s: float
    interval_s: float
    dropped: int


@dataclass(frozen=True)
class _FrameLoad:
    """A frame's part of the interval: on the wall clock, and of the processor.

    was_late: dropped frames came before it.
    """

    at_s: float
    busy: float
    cpu: float
    was_late: bool


class LoadMeter:
    """The mean over the last seconds of busy time as a share of the frame interval.

    A mean, not a median: under a quota of processor time most frames are quick, and every third
    one waits for long.
    """

    def __init__(self) -> None:
        self._frames: deque[_FrameLoad] = deque()
        self._first_s: float | None = None
        self._last_s = 0.0
        self._dropped: int | None = None

    def add(self, load: FrameCost, now_s: float) -> None:
        """Take one frame that was done at `now_s`."""
        if now_s - load.busy_s - self._last_s > MAX_IDLE_S:
            self.clear()
        self._last_s = now_s
        has_dropped = self._dropped is not None and load.dropped > self._dropped
        self._dropped = load.dropped
        if load.interval_s > 0.0:
            self._first_s = now_s if self._first_s is None else self._first_s
            share = min(load.busy_s / load.interval_s, MAX_FRAME_LOAD)
            # Where frames are dropped there is no room, however quick the others are.
            busy = max(share, 1.0) if has_dropped else share
            self._frames.append(_FrameLoad(now_s, busy, load.cpu_s / load.interval_s, has_dropped))
            self._drop_old(now_s)

    def _drop_old(self, now_s: float) -> None:
        while len(self._frames) > MIN_FRAMES and now_s - self._frames[0].at_s > WINDOW_S:
            self._frames.popleft()

    def clear(self) -> None:
        """Begin anew: what was measured no longer holds."""
        self._frames.clear()
        self._first_s = None

    @property
    def load(self) -> float | None:
        """1.0 = busy all the time; more = late. None while too little has been seen."""
        if self._first_s is None or self._last_s - self._first_s < WINDOW_S:
            return None
        if len(self._frames) < MIN_FRAMES:
            return None
        return sum(share.busy for share in self._frames) / len(self._frames)

    @property
    def late_frames(self) -> int:
        """Frames of the last seconds with dropped ones before them; a hiccup is one."""
        return sum(share.was_late for share in self._frames)

    @property
    def is_starved_of_cpu(self) -> bool:
        """Whether most of the busy time was spent waiting for the processor."""
        busy, cpu = (sum(getattr(s, what) for s in self._frames) for what in ("busy", "cpu"))
        return bool(cpu < 0.5 * busy)

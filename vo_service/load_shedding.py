"""Load shedding: while the odometry is late, the viewers are paused."""

import logging
import math
import time
from collections.abc import Callable, Sequence

from vo_service.config_tables import LoadConfig
from vo_service.types.outputs import PausableViewer

logger = logging.getLogger(__name__)

# The load is an exponential mean with this time constant. The first frames after a start are not
# counted: kernels are loaded.
TIME_CONSTANT_S, STARTUP_S = 2.0, 3.0
# Upper bound of one frame's load, in frame intervals: one slow frame is not overload.
MAX_FRAME_LOAD = 2.0
# Pause above the first; resume when the load has been below the second for a while.
MAX_LOAD, MAX_LOAD_TO_RESUME = 0.8, 0.6
# Each pause takes at least twice as long as the last one, unless the viewer ran long in between.
MIN_PAUSE_S, MAX_PAUSE_S, LONG_RUN_S = 10.0, 600.0, 60.0
# Time without frames (no camera, a pause) does not count as low load.
MAX_IDLE_S = 1.0


class LoadShedder:
    """Pauses the viewers while the loop has no time left between frames.

    Args:
        viewers: Viewers to pause; without one it does nothing.
        now_s: The clock, s.
    """

    def __init__(
        self, viewers: Sequence[PausableViewer], now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self._viewers, self._now_s = viewers, now_s
        self._is_enabled, self._is_paused = True, False
        self._load, self._dropped = 0.0, 0
        self._counted_since_s, self._last_s = math.inf, -math.inf
        self._low_since_s, self._resumed_s = math.inf, -math.inf
        self._pause_s = MIN_PAUSE_S

    @property
    def warning(self) -> str:
        """Why the viewer is paused; "" if it is not."""
        return "the machine is too slow: the viewer is paused" if self._is_paused else ""

    def configure(self, settings: LoadConfig) -> None:
        """Apply new settings; the viewers run again."""
        self._is_enabled = settings.adapt
        self._set_paused(False)

    def add_frame(self, busy_s: float, interval_s: float, dropped: int) -> None:
        """Add the last frame, and pause or resume the viewers if necessary.

        Args:
            busy_s: Time from its arrival in the loop to the end of its processing, s.
            interval_s: The camera's frame interval, s; 0 while unknown.
            dropped: Number of frames dropped since the start because the loop was late.
        """
        has_dropped, self._dropped = dropped > self._dropped, dropped
        if not (self._is_enabled and self._viewers and interval_s > 0.0):
            return
        now_s = self._now_s()
        if now_s - busy_s - self._last_s > MAX_IDLE_S:
            self._counted_since_s, self._low_since_s = now_s + STARTUP_S, math.inf
        self._last_s = now_s
        if now_s < self._counted_since_s:
            return
        share = min(busy_s / interval_s, MAX_FRAME_LOAD)
        share = max(share, 1.0) if has_dropped else share
        self._load += min(1.0, interval_s / TIME_CONSTANT_S) * (share - self._load)
        if self._load > MAX_LOAD:
            self._pause(now_s)
        elif self._is_paused:
            self._resume_if_due(now_s)

    def _pause(self, now_s: float) -> None:
        self._low_since_s = math.inf
        if not self._is_paused:
            had_long_run = now_s - self._resumed_s > LONG_RUN_S
            self._pause_s = MIN_PAUSE_S if had_long_run else min(2 * self._pause_s, MAX_PAUSE_S)
            self._set_paused(True)
            logger.warning("%s", self.warning)

    def _resume_if_due(self, now_s: float) -> None:
        if self._load >= MAX_LOAD_TO_RESUME:
            self._low_since_s = math.inf
            return
        self._low_since_s = min(self._low_since_s, now_s)
        if now_s - self._low_since_s >= self._pause_s:
            self._resumed_s = now_s
            self._set_paused(False)
            logger.warning("the load is low again: the viewer draws")

    def _set_paused(self, is_paused: bool) -> None:
        self._is_paused, self._low_since_s = is_paused, math.inf
        for viewer in self._viewers:
            viewer.set_paused(is_paused)

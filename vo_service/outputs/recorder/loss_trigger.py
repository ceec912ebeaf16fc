"""When a loss of tracking is worth an incident."""

import math

from vo_service.types import TrackingState

# The loss itself shall be in what is written.
DELAY_S = 1.0
# A robot in the dark is lost again and again: the first time tells enough.
MIN_INTERVAL_S = 30.0
_TRACKED_STATES = (TrackingState.TRACKING, TrackingState.DEGRADED)


class LossTrigger:
    """Says when to write an incident: a second after the pose was lost, and then not for a while.

    Times are seconds on CLOCK_MONOTONIC.
    """

    def __init__(self) -> None:
        self._last_state = TrackingState.NO_CAMERA
        self._due_s = math.inf
        self._suppressed_until_s = -math.inf

    @property
    def is_pending(self) -> bool:
        """Whether a loss has been seen that is not written yet."""
        return self._due_s < math.inf

    def update(self, state: TrackingState, now_s: float) -> None:
        """Take the state of the next pose."""
        has_lost = state is TrackingState.LOST and self._last_state in _TRACKED_STATES
        if has_lost and now_s >= self._suppressed_until_s:
            self._due_s = now_s + DELAY_S
            self._suppressed_until_s = now_s + MIN_INTERVAL_S
        self._last_state = state

    def is_due(self, now_s: float) -> bool:
        """True once, when the incident should be written."""
        if now_s < self._due_s:
            return False
        self._due_s = math.inf
        return True


class NullLossTrigger:
    """Where losses are not to be written."""

    is_pending = False

    def update(self, state: TrackingState, now_s: float) -> None:
        """Nothing comes of it."""

    def is_due(self, now_s: float) -> bool:
        """Never."""
        return False

"""When a loss of tracking is saved as an incident."""

import math

from vo_service.types.odometry_update import TrackingState

# The incident must contain the loss itself.
DELAY_S = 1.0
# In the dark, tracking is lost again and again; one incident is enough.
MIN_INTERVAL_S = 30.0
_TRACKED_STATES = (TrackingState.TRACKING, TrackingState.DEGRADED)


class LossTrigger:
    """Trigger that fires one second after a loss, then not again for a while.

    Times are seconds on CLOCK_MONOTONIC.
    """

    def __init__(self) -> None:
        self._last_state = TrackingState.NO_CAMERA
        self._due_s = math.inf
        self._suppressed_until_s = -math.inf

    @property
    def is_pending(self) -> bool:
        """Whether the trigger is still to fire for a loss."""
        return self._due_s < math.inf

    def update(self, state: TrackingState, now_s: float) -> None:
        """Add the state of the next pose."""
        is_new_loss = state is TrackingState.LOST and self._last_state in _TRACKED_STATES
        if is_new_loss and now_s >= self._suppressed_until_s:
            self._due_s = now_s + DELAY_S
            self._suppressed_until_s = now_s + MIN_INTERVAL_S
        self._last_state = state

    def is_due(self, now_s: float) -> bool:
        """Return True once, when the incident should be written."""
        if now_s < self._due_s:
            return False
        self._due_s = math.inf
        return True

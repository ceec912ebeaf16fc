"""When the graph of places is to be corrected by its loops: it costs time, the more the larger."""

import math

# Loops that do not say that the map is off correct it when so many places have come.
MAX_PENDING_KEYFRAMES = 10
# A large map is corrected once in this share of its places at most, whatever loops say: a new place
# costs the same time, however many there are.
MIN_INTERVAL_RATIO = 0.01


class OptimizationSchedule:
    """Counts places that come, and corrections."""

    def __init__(self) -> None:
        self._pending_keyframes = 0  # places since the first loop that the map is not corrected by
        self._keyframes_since_optimization = math.inf  # places since the last correction
        self._is_inconsistent = False

    @property
    def has_pending_loops(self) -> bool:
        """Whether there are loops that the map is not corrected by yet."""
        return self._pending_keyframes > 0

    def add_keyframe(self, keyframe_count: int, *, has_loops: bool, is_inconsistent: bool) -> bool:
        """Whether to correct now, after one more place; `is_inconsistent`: its loops say that it has to be.

        places  how many there are
        """
        self._keyframes_since_optimization += 1
        self._pending_keyframes += has_loops or self.has_pending_loops
        self._is_inconsistent |= is_inconsistent
        is_called_for = self._is_inconsistent or self._pending_keyframes > MAX_PENDING_KEYFRAMES
        return (
            is_called_for
            and self._keyframes_since_optimization >= MIN_INTERVAL_RATIO * keyframe_count
        )

    def mark_optimized(self) -> None:
        """The map has been corrected by all of its loops."""
        self._pending_keyframes, self._keyframes_since_optimization = 0, 0
        self._is_inconsistent = False

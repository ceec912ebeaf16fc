"""When to optimize the pose graph."""

import math

# Consistent loops are optimized after this many keyframes.
MAX_PENDING_KEYFRAMES = 10
# Smallest number of keyframes between two optimizations, as a share of all keyframes: so the cost
# per keyframe does not grow with the map.
MIN_INTERVAL_RATIO = 0.01


class OptimizationSchedule:
    """Count keyframes and optimizations."""

    def __init__(self) -> None:
        self._pending_keyframes = 0  # since the first loop that is not optimized yet
        self._keyframes_since_optimization = math.inf
        self._is_inconsistent = False

    @property
    def has_pending_loops(self) -> bool:
        """Whether there are loops that are not optimized yet."""
        return self._pending_keyframes > 0

    def add_keyframe(self, keyframe_count: int, *, has_loops: bool, is_inconsistent: bool) -> bool:
        """Add a keyframe; return whether to optimize now.

        Args:
            has_loops: Whether the keyframe has loops.
            is_inconsistent: Whether these differ from the map.
        """
        self._keyframes_since_optimization += 1
        self._pending_keyframes += has_loops or self.has_pending_loops
        self._is_inconsistent |= is_inconsistent
        is_due = self._is_inconsistent or self._pending_keyframes > MAX_PENDING_KEYFRAMES
        return is_due and self._keyframes_since_optimization >= MIN_INTERVAL_RATIO * keyframe_count

    def mark_optimized(self) -> None:
        """Mark all loops as optimized."""
        self._pending_keyframes, self._keyframes_since_optimization = 0, 0
        self._is_inconsistent = False

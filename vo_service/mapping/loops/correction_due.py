"""When the graph of places is to be corrected by its loops: it costs time, the more the larger."""

import math

# Loops that do not say that the map is off correct it when so many places have come.
PLACES_BETWEEN = 10
# A large map is corrected once in this share of its places at most, whatever loops say: a new place
# costs the same time, however many there are.
SHARE_BETWEEN = 0.01


class CorrectionDue:
    """Counts places that come, and corrections."""

    def __init__(self) -> None:
        self._with_loops = 0  # places since the first loop that the map is not corrected by
        self._since_last = math.inf  # places since the last correction
        self._is_off = False

    @property
    def has_loops(self) -> bool:
        """Whether there are loops that the map is not corrected by yet."""
        return self._with_loops > 0

    def next(self, places: int, *, has_loops: bool, is_off: bool) -> bool:
        """Whether to correct now, after one more place; `is_off`: its loops say that it has to be.

        places  how many there are
        """
        self._since_last += 1
        self._with_loops += has_loops or self.has_loops
        self._is_off |= is_off
        is_called_for = self._is_off or self._with_loops > PLACES_BETWEEN
        return is_called_for and self._since_last >= SHARE_BETWEEN * places

    def corrected(self) -> None:
        """The map has been corrected by all of its loops."""
        self._with_loops, self._since_last = 0, 0
        self._is_off = False

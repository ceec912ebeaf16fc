"""How much the stamps of wheels are ahead, learned from turns that camera and wheels both see.

A wrong stamp shows as a difference of the yaw rates in proportion to the angular acceleration:
recursive least squares with one unknown.
"""

from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

# Standard deviation of the difference of the yaw rates, rad/s, and of the offset before any turn.
RATE_SIGMA_RAD_S, PRIOR_SIGMA_S = 0.05, 0.1
# A frame's weight after a minute of turns is a third.
FADING = 0.9995
# A larger difference is slip; a larger offset is that of clocks that are not synchronized.
MAX_RATE_ERROR_RAD_S, MAX_OFFSET_S = 0.3, 0.2
# The acceleration is that between these times before and after a frame, s.
DIFFERENCE_S = 0.05
# Frames that wait for the readings after them.
MAX_PENDING = 16


# The wheels' mean yaw rate between two stamps of theirs, rad/s; None if it is not known.
YawRate = Callable[[float, float], float | None]


class _Turn(NamedTuple):
    """What the camera has seen between two frames."""

    from_s: float
    to_s: float
    rate_rad_s: float


class StampOffset:
    """Learns the offset of the wheels' stamps.

    Attributes:
        value_s: Stamp of the wheels minus that of the camera for the same instant.
    """

    def __init__(self) -> None:
        self.value_s = 0.0
        self._squared, self._product = 0.0, 0.0
        self._pending: deque[_Turn] = deque(maxlen=MAX_PENDING)

    def add(
        self, from_s: float, to_s: float, yaw_rad: float, newest_s: float, wheels: YawRate
    ) -> None:
        """Add the angle that the camera has turned between two frames in good view.

        Args:
            from_s: Stamp of the first frame.
            to_s: Stamp of the second frame.
            yaw_rad: The angle.
            newest_s: Stamp of the newest reading of the wheels.
            wheels: Their yaw rate.
        """
        if to_s > from_s:
            self._pending.append(_Turn(from_s, to_s, yaw_rad / (to_s - from_s)))
        while self._pending and self._end_s(self._pending[0]) <= newest_s:
            self._compare(self._pending.popleft(), wheels)

    def _end_s(self, turn: _Turn) -> float:
        """Stamp of the last reading that a comparison needs."""
        return turn.to_s + self.value_s + DIFFERENCE_S

    def _compare(self, turn: _Turn, wheels: YawRate) -> None:
        begin_s, end_s = turn.from_s + self.value_s, turn.to_s + self.value_s
        rate = wheels(begin_s, end_s)
        before = wheels(begin_s - DIFFERENCE_S, end_s - DIFFERENCE_S)
        after = wheels(begin_s + DIFFERENCE_S, end_s + DIFFERENCE_S)
        if rate is None or before is None or after is None:
            return
        error = turn.rate_rad_s - rate
        if abs(error) > MAX_RATE_ERROR_RAD_S:
            return
        acceleration = (after - before) / (2.0 * DIFFERENCE_S)
        self._squared = FADING * self._squared + acceleration**2
        self._product = FADING * self._product + acceleration * (
            error + acceleration * self.value_s
        )
        offset_s = self._product / (self._squared + (RATE_SIGMA_RAD_S / PRIOR_SIGMA_S) ** 2)
        self.value_s = float(np.clip(offset_s, -MAX_OFFSET_S, MAX_OFFSET_S))

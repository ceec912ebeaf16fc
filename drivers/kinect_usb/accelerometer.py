"""Gravity averaged over one second, from the counts of a Kinect's accelerometer (KXSD9)."""

import math
from collections import deque
from statistics import fmean

from drivers.core.geometry import (
    STANDARD_GRAVITY_M_S2,
    Vector,
    gravity_from_accelerometer,
    is_gravity,
)

COUNTS_PER_G = 819.0
AVERAGING_WINDOW_S = 1.0


def gravity_from_counts(x: int, y: int, z: int) -> Vector | None:
    """Convert counts to gravity in camera axes, m/s^2; None for three zeros (no data)."""
    if not any((x, y, z)):
        return None
    per_count = STANDARD_GRAVITY_M_S2 / COUNTS_PER_G
    return gravity_from_accelerometer((x * per_count, y * per_count, z * per_count))


class GravityFilter:
    """The mean gravity of the last second. One thread adds readings; any thread may read it."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, Vector]] = deque()
        self._ignored_until_s = -math.inf
        self._mean: tuple[float, Vector] | None = None  # replaced as a whole: needs no lock

    def add(self, gravity: Vector | None, now_s: float, is_moving: bool) -> bool:
        """Add a reading; return False if it cannot be gravity and is ignored.

        While the head moves, earlier readings are discarded because the pose has changed.
        """
        if is_moving or now_s < self._ignored_until_s:
            self.reset()
        if gravity is None or not is_gravity(gravity):
            return False
        self._readings.append((now_s, gravity))
        while self._readings[0][0] < now_s - AVERAGING_WINDOW_S:
            self._readings.popleft()
        x, y, z = zip(*(reading for _, reading in self._readings), strict=True)
        self._mean = (now_s, (fmean(x), fmean(y), fmean(z)))
        return True

    def ignore_until(self, until_s: float) -> None:
        """Discard earlier readings until then, because the head starts to move."""
        self._ignored_until_s = until_s

    def reset(self) -> None:
        """Discard all readings."""
        self._readings.clear()
        self._mean = None

    def mean_at(self, now_s: float) -> Vector | None:
        """Return the mean of the last second; None if the last reading is older. Never waits."""
        mean = self._mean
        return mean[1] if mean is not None and now_s - mean[0] <= AVERAGING_WINDOW_S else None

"""Gravity from a Kinect's accelerometer, in camera axes.

The accelerometer (Kionix KXSD9, 819 counts per g) sits in the head, beside the cameras: the motor
keeps its tilt against the horizon by it, so no angle of the motor comes into this. It measures the
push against gravity on x left, y up, z forward, so that a level Kinect reads (0, +819, 0).
Sources: Microsoft's SDK gives gravity as (0, -1, 0) in these axes; MRPT and RTAB-Map take the raw
values as gravity to the right, down and backwards, which is the same. Not seen on a device here.
"""

import math
from collections import deque
from statistics import fmean

COUNTS_PER_G = 819.0
STANDARD_GRAVITY_M_S2 = 9.80665
# A reading whose length is further off measures a push or a fault, not gravity alone.
TOLERANCE = 0.1
SMOOTHED_OVER_S = 1.0
Gravity = tuple[float, float, float]


def gravity_from_counts(x: int, y: int, z: int) -> Gravity:
    """Gravity (right, down, forward) in m/s^2 from the accelerometer's counts."""
    per_count = STANDARD_GRAVITY_M_S2 / COUNTS_PER_G
    return (x * per_count, y * per_count, -z * per_count)


def is_gravity(vector_m_s2: Gravity) -> bool:
    """False if its length is more than 10 % off: the camera is being pushed, or it is no data."""
    off = abs(math.hypot(*vector_m_s2) / STANDARD_GRAVITY_M_S2 - 1.0)
    return off <= TOLERANCE


class GravityMeter:
    """Gravity over the last second. One thread adds to it; any thread may ask."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, Gravity]] = deque()
        self._unsettled_until_s = -math.inf
        self._mean: tuple[float, Gravity] | None = None  # replaced whole, so that no lock is needed

    def add(self, gravity: Gravity | None, now_s: float, is_moving: bool) -> bool:
        """Take a reading; returns False if it cannot be gravity, and is left out.

        While the head moves the reading stands alone: those before it were of another pose.
        """
        if is_moving or now_s < self._unsettled_until_s:
            self.forget()
        if gravity is None or not is_gravity(gravity):
            return False
        self._readings.append((now_s, gravity))
        while self._readings[0][0] < now_s - SMOOTHED_OVER_S:
            self._readings.popleft()
        x, y, z = zip(*(reading for _, reading in self._readings), strict=True)
        self._mean = (now_s, (fmean(x), fmean(y), fmean(z)))
        return True

    def expect_motion(self, until_s: float) -> None:
        """The head has been told to move."""
        self._unsettled_until_s = until_s

    def forget(self) -> None:
        """What was measured is of another time."""
        self._readings.clear()
        self._mean = None

    def at(self, now_s: float) -> Gravity | None:
        """The mean of the last second's readings; None if the last one is older. Never waits."""
        mean = self._mean
        return mean[1] if mean is not None and now_s - mean[0] <= SMOOTHED_OVER_S else None

"""Whether wheels slip, by the motion that the camera has seen."""

import math

MAX_SIGMAS = 3.0
MIN_FRAMES = 3
SLIP_S = 1.0
# A slipping wheel's standard deviations are so many times the usual ones.
SLIP_FACTOR = 10.0


class SlipDetector:
    """Compares the motion of the wheels with that of the camera, frame by frame."""

    def __init__(self) -> None:
        self._excesses = 0
        self._slip_s = -math.inf

    def add(self, stamp_s: float, sigmas: float) -> bool:
        """Add a frame in which the camera's motion is certain.

        Args:
            stamp_s: Its stamp.
            sigmas: How many standard deviations the two motions differ by.

        Returns:
            Whether the wheels slip.
        """
        self._excesses = self._excesses + 1 if sigmas > MAX_SIGMAS else 0
        if self._excesses < MIN_FRAMES:
            return False
        self._slip_s = stamp_s
        return True

    def skip(self) -> None:
        """Skip a frame in which nothing can be told: the frames are no longer in a row."""
        self._excesses = 0

    def factor(self, stamp_s: float) -> float:
        """Return what to multiply the standard deviations at a time with."""
        return SLIP_FACTOR if abs(stamp_s - self._slip_s) <= SLIP_S else 1.0

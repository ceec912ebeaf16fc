"""At most so often."""


class Throttle:
    """Lets something through at most once a period, on whatever clock the caller has."""

    def __init__(self, period_s: float) -> None:
        # A camera's stamps are never exactly even: a frame that is almost due is due.
        self._period_s = 0.9 * period_s
        self._last_s = float("-inf")

    def allow(self, now_s: float) -> bool:
        """True if the period has passed, or the clock was set back."""
        if 0.0 <= now_s - self._last_s < self._period_s:
            return False
        self._last_s = now_s
        return True

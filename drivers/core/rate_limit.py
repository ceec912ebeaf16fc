"""At most so often."""

import time
from collections.abc import Callable


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


class TokenBucket:
    """Holds up to a second's worth of tokens (at least one) and fills at a steady rate.

    For one thread.
    """

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self.per_second = per_second
        self._now_s = now_s
        self._capacity = max(1.0, per_second)
        self._tokens = self._capacity
        self._last_refill_s = now_s()

    def try_acquire(self) -> bool:
        """Take a token; False where there is none."""
        self._refill()
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def seconds_until_next(self) -> float:
        """Seconds until there is a token; 0 where there is one."""
        self._refill()
        return max(0.0, (1.0 - self._tokens) / self.per_second)

    def _refill(self) -> None:
        now_s = self._now_s()
        self._tokens += (now_s - self._last_refill_s) * self.per_second
        self._tokens = min(self._tokens, self._capacity)
        self._last_refill_s = now_s

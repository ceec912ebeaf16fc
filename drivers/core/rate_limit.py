"""Rate limits: a throttle on a caller's clock, and a token bucket."""

import time
from collections.abc import Callable


class Throttle:
    """Allows an event at most once per period, on the caller's clock."""

    def __init__(self, period_s: float) -> None:
        # A camera's stamps jitter: a frame that is almost due counts as due.
        self._period_s = 0.9 * period_s
        self._last_s = float("-inf")

    def allow(self, now_s: float) -> bool:
        """Return whether the period has passed since the last allowed event.

        Always True if the clock was set back.
        """
        if 0.0 <= now_s - self._last_s < self._period_s:
            return False
        self._last_s = now_s
        return True


class TokenBucket:
    """A token bucket that holds the tokens of one second (at least one). Not thread-safe."""

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self.per_second = per_second
        self._now_s = now_s
        self._capacity = max(1.0, per_second)
        self._tokens = self._capacity
        self._last_refill_s = now_s()

    def try_acquire(self) -> bool:
        """Take a token; return False if there is none."""
        self._refill()
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def seconds_until_next(self) -> float:
        """Return the seconds until there is a token; 0 if there is one."""
        self._refill()
        return max(0.0, (1.0 - self._tokens) / self.per_second)

    def _refill(self) -> None:
        now_s = self._now_s()
        self._tokens += (now_s - self._last_refill_s) * self.per_second
        self._tokens = min(self._tokens, self._capacity)
        self._last_refill_s = now_s

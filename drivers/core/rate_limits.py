"""Limits of rates, and waits between retries."""

import time
from collections.abc import Callable


class Throttle:
    """Allows an event at most once per period on average, on the caller's clock.

    Events are due on a grid of periods. One that is a quarter of a period early is allowed, and one
    that is as late does not move the grid: a camera's jitter, or a frame rate that is no multiple,
    loses no event.
    """

    def __init__(self, period_s: float) -> None:
        self._period_s = period_s
        self._tolerance_s = 0.25 * period_s
        self._last_s = self._due_s = float("-inf")

    def allow(self, now_s: float) -> bool:
        """Return whether an event is due; always True if the clock was set back."""
        if self._last_s <= now_s < self._due_s - self._tolerance_s:
            return False
        is_new_grid = now_s < self._last_s or now_s > self._due_s + self._period_s
        on_grid_s = now_s if is_new_grid else max(self._due_s, now_s - self._tolerance_s)
        self._last_s, self._due_s = now_s, on_grid_s + self._period_s
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


class ExponentialBackoff:
    """Waits that double while nothing works."""

    def __init__(self, initial_s: float, max_s: float) -> None:
        self._initial_s, self._max_s = initial_s, max_s
        self._next_s = initial_s

    def next_s(self) -> float:
        """How long to wait this time."""
        wait_s = self._next_s
        self._next_s = min(2 * wait_s, self._max_s)
        return wait_s

    def reset(self) -> None:
        """Start again with the shortest wait: it worked."""
        self._next_s = self._initial_s

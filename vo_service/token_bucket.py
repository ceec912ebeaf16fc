"""A limit on how often something may happen: so many a second, with room for a short burst."""

import time
from collections.abc import Callable


class TokenBucket:
    """Holds up to a second's worth of tokens (at least one) and fills at a steady rate.

    For one thread.
    """

    def __init__(self, per_second: float, now_s: Callable[[], float] = time.monotonic) -> None:
        self.per_second = per_second
        self._now_s = now_s
        self._most = max(1.0, per_second)
        self._tokens = self._most
        self._filled_s = now_s()

    def take(self) -> bool:
        """Take a token; False where there is none."""
        self._fill()
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def next_s(self) -> float:
        """Seconds until there is a token; 0 where there is one."""
        self._fill()
        return max(0.0, (1.0 - self._tokens) / self.per_second)

    def _fill(self) -> None:
        now_s = self._now_s()
        self._tokens += (now_s - self._filled_s) * self.per_second
        self._tokens = min(self._tokens, self._most)
        self._filled_s = now_s

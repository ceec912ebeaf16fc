"""How soon something that failed is tried again."""


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

"""The fault of a file that cannot be written at present, and when it is tried again."""

import math
import time

from drivers.core import UserFacingError

RETRY_PERIOD_S = 1.0


class WriteFault:
    """Why a file is not written at present, and what was lost. A full disk may work again.

    Attributes:
        data_loss: The first error; None while nothing is lost.
    """

    def __init__(self) -> None:
        self.data_loss: UserFacingError | None = None
        self._error: UserFacingError | None = None
        self._retry_s = -math.inf  # CLOCK_MONOTONIC

    def set(self, error: UserFacingError, *, can_retry: bool) -> bool:
        """Suspend the writing; return whether the cause is another one than before."""
        self._retry_s = time.monotonic() + RETRY_PERIOD_S if can_retry else math.inf
        self.data_loss = self.data_loss or error
        if self and getattr(error, "errno", None) == getattr(self._error, "errno", None):
            return False
        self._error = error
        return True

    def clear(self) -> None:
        """The file is written again."""
        self._error, self._retry_s = None, -math.inf

    def __bool__(self) -> bool:
        """Whether the file is not written at present."""
        return self._error is not None

    @property
    def is_retry_due(self) -> bool:
        """Whether to try it now."""
        return time.monotonic() >= self._retry_s

    def __str__(self) -> str:
        error, retry_s = self._error, self._retry_s  # the thread may clear it
        if error is None:
            return ""
        return f"{error}; recording then continues" if retry_s < math.inf else str(error)

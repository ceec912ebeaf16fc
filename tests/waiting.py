"""Waiting for a condition: the one place where tests poll."""

import inspect
import time
from collections.abc import Callable

# Longer than any wait on a slow machine, shorter than the time limit of a test.
DEFAULT_TIMEOUT_S = 100.0
POLL_PERIOD_S = 0.01


def wait_until(
    condition: Callable[[], object],
    what: str | Callable[[], str] = "",
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> None:
    """Wait until a condition is true.

    Args:
        condition: Called every `POLL_PERIOD_S`; it should have no side effects.
        what: Description for the error, or makes it; the condition's source if empty.
        timeout_s: Longest time to wait.

    Raises:
        AssertionError: The condition did not become true in time.
    """
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            told = what() if callable(what) else what or _source(condition)
            raise AssertionError(f"waited {timeout_s:g} s in vain for {told}")
        time.sleep(POLL_PERIOD_S)  # the only place where tests poll


def _source(condition: Callable[[], object]) -> str:
    """Source of a function, or its name if the source is not available."""
    try:
        return inspect.getsource(condition).strip()
    except (OSError, TypeError):
        return repr(condition)

"""Waiting for a condition: the one place where tests poll."""

import inspect
import time
from collections.abc import Callable

# Longer than anything takes on a slow day, shorter than the time limit of a test.
DEFAULT_TIMEOUT_S = 100.0
POLL_PERIOD_S = 0.01


def wait_until(
    condition: Callable[[], object], what: str = "", *, timeout_s: float = DEFAULT_TIMEOUT_S
) -> None:
    """Wait until a condition is true.

    Args:
        condition: called every `POLL_PERIOD_S`; should have no side effects that matter.
        what: what is awaited, for the error; the condition's source where empty.
        timeout_s: how long to wait at most.

    Raises:
        AssertionError: it did not become true in time.
    """
    deadline_s = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline_s:
            raise AssertionError(f"waited {timeout_s:g} s in vain for {what or _source(condition)}")
        time.sleep(POLL_PERIOD_S)  # polls; no test does so by itself


def _source(condition: Callable[[], object]) -> str:
    """The source of a function, or its name where that cannot be read."""
    try:
        return inspect.getsource(condition).strip()
    except (OSError, TypeError):
        return repr(condition)

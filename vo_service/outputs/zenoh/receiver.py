"""A thread that takes what comes on a session, no faster than allowed."""

import threading
import time
from collections.abc import Callable
from typing import Any

import zenoh

from drivers.core.rate_limits import TokenBucket

# Above this, Zenoh drops the oldest, without any Python code.
MAX_PENDING = 16

Source = zenoh.Queryable[zenoh.Handler[Any]] | zenoh.Subscriber[zenoh.Handler[Any]]


def start_receiver(
    source: Source, key: str, per_second: float, handle: Callable[[Any], object]
) -> threading.Thread:
    """Hand queries or messages over, one after another, on a thread that ends with the session.

    They wait in Zenoh, not in Python, so a flood of them takes no CPU time from the poses.

    Args:
        source: What is declared, with a channel.
        key: Its key, for the name of the thread.
        per_second: How many are taken at most.
        handle: Takes each; it must not raise.
    """
    thread = threading.Thread(
        target=_receive, args=(source, per_second, handle), name=f"zenoh-{key}", daemon=True
    )
    thread.start()
    return thread


def _receive(source: Source, per_second: float, handle: Callable[[Any], object]) -> None:
    rate_limit = TokenBucket(per_second)
    # Not `source.recv`: it would keep the source borrowed, and closing would fail.
    channel = source.handler
    while True:
        time.sleep(rate_limit.seconds_until_next())
        try:
            item = channel.recv()
        except zenoh.ZError:  # the session has closed
            return
        rate_limit.try_acquire()
        handle(item)

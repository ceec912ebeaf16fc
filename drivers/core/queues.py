"""Bounded queues, and the worker thread that reads one.

Blocking work on a worker thread delays no odometry.
"""

import logging
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

logger = logging.getLogger(__name__)

T = TypeVar("T")


class BoundedQueue(ABC, Generic[T]):
    """A bounded queue between one producer and one consumer.

    Attributes:
        delivered: The number of items that the consumer has taken.
        dropped: The number of items that newer ones replaced.
    """

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.delivered = self.dropped = 0
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self._end: Exception | None = None

    @abstractmethod
    def _make_room(self) -> None:
        """Called with the lock held while the queue is full."""

    def put(self, item: T) -> None:
        """Add one item; after the end it is discarded."""
        with self._changed:
            if len(self._items) >= self.capacity and self._end is None:
                self._make_room()
            if self._end is None:
                self._items.append(item)
                self._changed.notify_all()

    def get(self, timeout_s: float | None = None) -> T:
        """Wait for the oldest item.

        Raises:
            TimeoutError: There was no item within `timeout_s`.
            Exception: The queue is empty and has ended: `QueueClosed`, or as given to `finish`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._end, timeout_s)
            if not self._items:
                raise self._end or TimeoutError
            self.delivered += 1
            self._changed.notify_all()
            return self._items.popleft()

    def finish(self, end: Exception) -> None:
        """Accept no more items. After those in the queue, `get` raises the first `end` given."""
        with self._changed:
            self._end = self._end or end
            self._changed.notify_all()

    def abort(self, end: Exception) -> None:
        """Discard the items, and accept no more: `get` raises `end`."""
        with self._changed:
            self._items.clear()
            self._end = end
            self._changed.notify_all()

    def close(self) -> None:
        """Accept no more items; those in the queue can still be read."""
        self.finish(QueueClosed())


class DropOldestQueue(BoundedQueue[T]):
    """A queue that drops its oldest item when full: the producer never waits."""

    def _make_room(self) -> None:
        self._items.popleft()
        self.dropped += 1


class BlockingQueue(BoundedQueue[T]):
    """A queue that loses nothing: the producer waits until there is room."""

    def _make_room(self) -> None:
        self._changed.wait_for(lambda: len(self._items) < self.capacity or self._end)


class QueueClosed(Exception):  # noqa: N818 (like StopIteration: not an error)
    """The queue is closed and empty."""


class WorkerThread(Generic[T]):
    """Calls `handle` for each item on a thread of its own, then `finish` once.

    Only the first error is logged; later items are still handled. The thread is a daemon, so that
    a hung library does not keep the process alive.
    """

    def __init__(
        self,
        name: str,
        queue: BoundedQueue[T],
        handle: Callable[[T], None],
        finish: Callable[[], None],
    ) -> None:
        self.name = name
        self.errors = 0
        self._queue = queue
        self._handle = handle
        self._finish = finish
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """The number of items that newer ones replaced before they were handled."""
        return self._queue.dropped

    def put(self, item: T) -> None:
        """Add one item to the queue."""
        self._queue.put(item)

    def close(self, timeout_s: float) -> bool:
        """Handle the waiting items, then finish.

        Returns:
            False if that takes longer than `timeout_s`; the thread then continues on its own.
        """
        self._queue.close()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while True:
                self._run_logging_errors(partial(self._handle, self._queue.get()))
        except QueueClosed:
            self._run_logging_errors(self._finish)

    def _run_logging_errors(self, function: Callable[[], None]) -> None:
        try:
            function()
        except BaseException as error:  # a panic in a Rust library is not an Exception
            self.errors += 1
            if self.errors == 1:
                logger.error(
                    "%s: %s (further errors are counted, not shown)",
                    self.name,
                    error,
                    exc_info=logger.isEnabledFor(logging.DEBUG),
                )

"""A thread that takes work off the odometry's hands: whatever blocks, blocks there."""

import logging
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Generic, TypeVar

logger = logging.getLogger(__name__)

T = TypeVar("T")


class HandOver(ABC, Generic[T]):
    """A bounded queue between one giver and one taker. `dropped` counts what was given up."""

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.dropped = 0
        self._waiting: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    @abstractmethod
    def _make_room(self) -> None:
        """Called with the lock held while the queue is full."""

    def put(self, item: T) -> None:
        """Hand over one item. After `close` nothing is taken any more."""
        with self._changed:
            if len(self._waiting) >= self.capacity and not self._closed:
                self._make_room()
            if not self._closed:
                self._waiting.append(item)
                self._changed.notify_all()

    def take(self) -> T:
        """Wait for the oldest item. Raises Closed when there will be no more."""
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                raise Closed
            self._changed.notify_all()
            return self._waiting.popleft()

    def close(self) -> None:
        """Take no more; what waits can still be taken."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()


class DropOldest(HandOver[T]):
    """The newest wins: the giver never waits."""

    def _make_room(self) -> None:
        self._waiting.popleft()
        self.dropped += 1


class Wait(HandOver[T]):
    """Nothing is lost: the giver waits until there is room."""

    def _make_room(self) -> None:
        self._changed.wait_for(lambda: len(self._waiting) < self.capacity or self._closed)


class Closed(Exception):  # noqa: N818 (like StopIteration: not an error)
    """The hand-over is closed and empty."""


class Worker(Generic[T]):
    """Calls `handle` for each item on a thread of its own, then `finish` once.

    An error is logged the first time only; the items after it are still handled. The thread is a
    daemon: one that is stuck in a library does not keep the process alive.
    """

    def __init__(
        self,
        name: str,
        hand_over: HandOver[T],
        handle: Callable[[T], None],
        finish: Callable[[], None],
    ) -> None:
        self.name = name
        self.errors = 0
        self._hand_over = hand_over
        self._handle = handle
        self._finish = finish
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Items that newer ones replaced before they were handled."""
        return self._hand_over.dropped

    def put(self, item: T) -> None:
        """Hand over one item."""
        self._hand_over.put(item)

    def close(self, timeout_s: float) -> bool:
        """Handle what waits, finish. False if that takes longer: the thread is left to itself."""
        self._hand_over.close()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            while True:
                self._guarded(partial(self._handle, self._hand_over.take()))
        except Closed:
            self._guarded(self._finish)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            work()
        except BaseException as error:  # a panic in a Rust library is no Exception
            self.errors += 1
            if self.errors == 1:
                logger.error(
                    "%s: %s (further errors are counted, not shown)",
                    self.name,
                    error,
                    exc_info=logger.isEnabledFor(logging.DEBUG),
                )

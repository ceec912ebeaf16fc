"""Base of the outputs with a process: the mapper, the recorder and the Rerun viewer.

Each of them adds its messages, and what it does with them.
"""

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from drivers.core import UserFacingError
from drivers.core.process.worker_client import WorkerClient
from drivers.core.process.worker_spec import WorkerConfig, WorkerSpec
from drivers.core.queues import BoundedQueue, WorkerThread
from drivers.core.rate_limits import ExponentialBackoff
from vo_service.types.commands import NotPossibleError

logger = logging.getLogger(__name__)

Item = TypeVar("Item")
Config = TypeVar("Config", bound=WorkerConfig)


class FaultReporter:
    """The current fault in `text`, "" for none. Each new one is logged once.

    Args:
        name: Name of the output in the log.
        level: Level of the log.
    """

    def __init__(self, name: str, level: int = logging.ERROR) -> None:
        self.text = ""
        self._name, self._level = name, level

    def set(self, text: str) -> None:
        """Set the current fault, "" for none."""
        if text and self._is_news(text):
            logger.log(self._level, "%s: %s", self._name, text)
        self.text = text

    def _is_news(self, text: str) -> bool:
        return text != self.text


class ProcessOutput(ABC, Generic[Item, Config]):
    """An output with a queue, a thread and a process. None of them delays the poses.

    The thread passes the items of the queue to the process: as records of a ring in shared memory,
    or as messages. A request is sent at once; its result is a message, which changes the state that
    is mirrored here. A process that ends is started again.

    Args:
        name: Name in warnings and in the log.
        close_timeout_s: How long the items in the queue may take at the end.
    """

    def __init__(self, name: str, close_timeout_s: float = 1.0) -> None:
        self._name, self._close_timeout_s = name, close_timeout_s
        self._lock = threading.Lock()  # of the state that requests and messages change
        self._memory_fault = ""
        self._is_closed = False

    def _start(
        self,
        spec: WorkerSpec,
        config: Config,
        queue: BoundedQueue[Item],
        backoff: ExponentialBackoff | None = None,
    ) -> None:
        """Start the process and the thread; called at the end of a subclass's `__init__`."""
        self._config = config  # of the next process
        self._client = WorkerClient(
            spec, self._make_config, self._handle_message, self._handle_exit, backoff
        )
        self._thread = WorkerThread(spec.name, queue, self._pass_on, self._finish)

    @property
    def warning(self) -> str:
        """The current faults in one clause; "" if there is none."""
        fault = self._memory_fault or self._fault
        if self._client.is_unresponsive and not self._memory_fault:
            fault = "its process does not respond; the disk may hang"
        return f"{self._name}: {fault}" if fault else ""

    @property
    def is_ready(self) -> bool:
        """Whether the process accepts requests."""
        return self._client.is_ready

    @property
    def dropped(self) -> int:
        """Number of items dropped from the queue."""
        return self._thread.dropped

    def close(self) -> None:
        """Pass on the last items, and end the process. Safe to call twice."""
        if not self._is_closed:
            self._is_closed = True
            due_s = time.monotonic() + self._close_timeout_s
            has_finished = self._thread.close(self._close_timeout_s)
            self._end(has_finished, max(0.0, due_s - time.monotonic()))

    @contextmanager
    def _requesting(self) -> Iterator[None]:
        """Hold the lock while a request is checked and sent.

        Raises:
            NotPossibleError: The process does not respond, so that the request would be lost.
        """
        with self._lock:
            if not self._client.is_ready or self._client.is_unresponsive:
                text = f"the {self._name}'s process does not respond; try again in a moment"
                raise NotPossibleError(text)
            yield

    @contextmanager
    def _writing_memory(self, content: str) -> Iterator[None]:
        """Report a lack of memory for the content that the block writes."""
        try:
            yield
            self._memory_fault = ""
        except OSError as error:
            self._memory_fault = f"no memory for {content}: {error.strerror}"

    @property
    @abstractmethod
    def _fault(self) -> str:
        """The current faults apart from those of memory; "" if there is none."""

    def _make_config(self) -> Config | None:
        """Return the configuration of the next process; None if none is to be started now."""
        return self._config

    @abstractmethod
    def _pass_on(self, item: Item) -> None:
        """Pass an item to the process, on the thread."""

    def _finish(self) -> None:
        """Send what follows the last item, on the thread."""

    @abstractmethod
    def _handle_message(self, message: Any) -> None:
        """Handle a message of the process, on the client's thread."""

    @abstractmethod
    def _handle_exit(self, reason: str) -> bool:
        """Report a process that ended; return whether another is to be started."""

    @abstractmethod
    def _end(self, has_finished: bool, left_s: float) -> None:
        """End the process, and release the memory if the thread has finished.

        Args:
            has_finished: Whether all items are passed on.
            left_s: What is left of `close_timeout_s`.
        """


def warn_disabled(prefix: str, no_memory: str, error: UserFacingError | OSError) -> str:
    """Log that an output cannot be opened, so that the service runs without it; return the text.

    Args:
        prefix: What the text says of the output.
        no_memory: What it says if there is no shared memory.
        error: Why the output cannot be opened.
    """
    cause = str(error)
    if not isinstance(error, UserFacingError):
        cause = f"{no_memory}: {error.strerror}"
    logger.warning("%s: %s", prefix, cause)
    return f"{prefix}: {cause}"

"""A worker's connection to the service, and the limits that end the process with it."""

import logging
import os
import select
import signal
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from drivers.core import UserFacingError
from drivers.core.process.messages import (
    LogMessage,
    Shutdown,
    WorkerFailed,
    receive_message,
    send_message,
)
from drivers.core.process.worker_spec import WorkerSpec

_MEMORY_PERIOD_S = 0.5
_BYTES_PER_MB = 1e6


class ServiceConnection:
    """The worker's end of the connection: messages both ways, and whether the worker shall end.

    A thread watches the service and the memory limit. When the service asks the worker to end, or
    has ended itself, `stop` is set; the process is killed if it runs longer than its exit timeout.

    Attributes:
        config: What the worker is to do.
        stop: Set when the worker shall end.
        is_connected: Whether the service is there; False after a crash of the service.
    """

    def __init__(self, connection: "Connection[Any, Any]", spec: WorkerSpec, config: Any) -> None:
        self.config = config
        self.stop = threading.Event()
        self.is_connected = True
        self._connection, self._spec = connection, spec
        self._send_lock, self._timer_lock = threading.Lock(), threading.Lock()
        # The kernel's timer kills the process unless it is set again, even while native code
        # holds the GIL and no thread of Python runs.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, spec.orphan_timeout_s)
        threading.Thread(target=self._watch, name="service-watch", daemon=True).start()

    def send(self, message: object) -> bool:
        """Send a message, from any thread. Returns False if the service has ended."""
        try:
            with self._send_lock:
                send_message(self._connection, message)
        except OSError:
            self._end(is_connected=False)
        return self.is_connected

    def receive(self, timeout_s: float | None = None, *others: "Connection[Any, Any]") -> Any:
        """Wait for the next message.

        Returns:
            The message; None after `timeout_s`, or if only `others` can be read.

        Raises:
            EOFError: The worker shall end; no message follows.
        """
        if self._connection not in wait([self._connection, *others], timeout_s):
            return None
        try:
            message = receive_message(self._connection)
        except (EOFError, OSError) as error:
            self._end(is_connected=False)
            raise EOFError from error
        if isinstance(message, Shutdown):
            self._end(is_connected=True)
            raise EOFError
        return message

    def messages(self, idle_s: float | None = None) -> Iterator[Any]:
        """Yield messages until the worker shall end, and None whenever `idle_s` has passed."""
        while True:
            try:
                message = self.receive(idle_s)
            except EOFError:
                return
            yield message

    def close(self) -> None:
        """Close the connection; for processes that inherit it."""
        self._connection.close()

    def _end(self, *, is_connected: bool) -> None:
        """Ask the worker to end, and kill it if it does not."""
        with self._timer_lock:
            self.is_connected = self.is_connected and is_connected
            if not self.stop.is_set():
                self.stop.set()
                signal.setitimer(signal.ITIMER_REAL, self._spec.exit_timeout_s)

    def _watch(self) -> None:
        """Body of the thread: watch the service and the memory until the worker shall end."""
        poll = select.poll()
        poll.register(self._connection.fileno(), 0)  # only the end of the other side
        period_s = _MEMORY_PERIOD_S if self._spec.memory_mb else self._spec.orphan_timeout_s / 3
        while not self.stop.is_set():
            with self._timer_lock:
                if not self.stop.is_set():
                    signal.setitimer(signal.ITIMER_REAL, self._spec.orphan_timeout_s)
            if self._spec.memory_mb:
                self._check_memory()
            if poll.poll(1e3 * period_s):
                self._end(is_connected=False)

    def _check_memory(self) -> None:
        # Pages of files, such as libraries, do not count: their number depends on the file system.
        resident, of_files = Path("/proc/self/statm").read_text().split()[1:3]
        pages = int(resident) - int(of_files)
        if pages * os.sysconf("SC_PAGE_SIZE") / _BYTES_PER_MB <= self._spec.memory_mb:
            return
        limit = f"{self._spec.memory_mb} MB ({self._spec.memory_key})"
        self.send(WorkerFailed(UserFacingError(f"exceeded {limit}")))
        os._exit(1)


class ForwardingHandler(logging.Handler):
    """Sends all log records of this process to the service's log."""

    def __init__(self, service: ServiceConnection) -> None:
        super().__init__()
        self._service = service

    def emit(self, record: logging.LogRecord) -> None:
        """Send a record."""
        self._service.send(LogMessage(record.levelno, record.name, self.format(record)))

"""A worker process's connection to the service that started it, also for log messages."""

import logging
import signal
import threading
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.process.worker_process import LogMessage


class ParentConnection:
    """Sends messages to the service from any thread.

    `is_connected` becomes False when the service has ended.
    """

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self.is_connected = True

    def send(self, message: object) -> bool:
        """Send a message. Returns False if the service has ended."""
        try:
            with self._lock:
                self._connection.send(message)
        except OSError:
            self.is_connected = False
        return self.is_connected


def ignore_terminal_signals(*more: signal.Signals) -> None:
    """Ignore Ctrl-C, the stop signal of systemd and `more`.

    These signals reach every process, but only the service handles them.
    """
    for number in (signal.SIGINT, signal.SIGTERM, *more):
        signal.signal(number, signal.SIG_IGN)


def forward_logs(parent: ParentConnection, level: int) -> None:
    """Send all log records of this process to the service's log."""
    handlers = [_ForwardingHandler(parent)]
    logging.basicConfig(level=level, format="%(message)s", handlers=handlers)


class _ForwardingHandler(logging.Handler):
    def __init__(self, parent: ParentConnection) -> None:
        super().__init__()
        self._parent = parent

    def emit(self, record: logging.LogRecord) -> None:
        self._parent.send(LogMessage(record.levelno, record.name, self.format(record)))

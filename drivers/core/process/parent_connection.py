"""What a process of ours says to the service that started it: words, and its log among them."""

import logging
import signal
import threading
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.process.messages import LogMessage


class ParentConnection:
    """Words for the service, from any thread. `is_connected` turns False when the service is gone."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self.is_connected = True

    def send(self, message: object) -> bool:
        """Send it. False if nobody hears it any more."""
        try:
            with self._lock:
                self._connection.send(message)
        except OSError:
            self.is_connected = False
        return self.is_connected


def ignore_terminal_signals(*more: signal.Signals) -> None:
    """Ignore Ctrl-C, a stop of the systemd unit, and `more`: these reach every process.

    The service decides what they mean.
    """
    for number in (signal.SIGINT, signal.SIGTERM, *more):
        signal.signal(number, signal.SIG_IGN)


def forward_logs(parent: ParentConnection, level: int) -> None:
    """From now on what this process logs stands in the service's log."""
    handlers = [_ForwardingHandler(parent)]
    logging.basicConfig(level=level, format="%(message)s", handlers=handlers)


class _ForwardingHandler(logging.Handler):
    def __init__(self, parent: ParentConnection) -> None:
        super().__init__()
        self._parent = parent

    def emit(self, record: logging.LogRecord) -> None:
        self._parent.send(LogMessage(record.levelno, record.name, self.format(record)))

"""What a process of ours says to the service that started it: words, and its log among them."""

import logging
import signal
import threading
from multiprocessing.connection import Connection
from typing import Any

from drivers.isolation.messages import LogLine


class Outbox:
    """Words for the service, from any thread. `is_heard` turns False when the service is gone."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self.is_heard = True

    def tell(self, word: object) -> bool:
        """Send it. False if nobody hears it any more."""
        try:
            with self._lock:
                self._connection.send(word)
        except OSError:
            self.is_heard = False
        return self.is_heard


def leave_signals_to_service(*more: signal.Signals) -> None:
    """Ignore Ctrl-C, a stop of the systemd unit, and `more`: these reach every process.

    The service decides what they mean.
    """
    for number in (signal.SIGINT, signal.SIGTERM, *more):
        signal.signal(number, signal.SIG_IGN)


def log_to_service(outbox: Outbox, level: int) -> None:
    """From now on what this process logs stands in the service's log."""
    handlers = [_LogToService(outbox)]
    logging.basicConfig(level=level, format="%(message)s", handlers=handlers)


class _LogToService(logging.Handler):
    def __init__(self, outbox: Outbox) -> None:
        super().__init__()
        self._outbox = outbox

    def emit(self, record: logging.LogRecord) -> None:
        self._outbox.tell(LogLine(record.levelno, record.name, self.format(record)))

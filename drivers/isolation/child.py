"""The driver's process: ``python -m drivers.isolation.child FD``, started by `ChildProcess`.

It ends with the service, whatever happens: in order where that is possible, by force where not.
"""

import logging
import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2

from drivers.errors import UserFacingError
from drivers.isolation.camera_loop import CameraLoop
from drivers.isolation.messages import Ended, Job, LogLine, Word
from drivers.isolation.ring import RingWriter


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says "end" or is gone."""
    # Ctrl-C and a stop of the systemd unit reach every process; the service decides what they mean.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_end_with_service`
    job: Job = connection.recv()
    outbox = _Outbox(connection)
    handlers = [_LogToService(outbox)]
    logging.basicConfig(level=job.log_level, format="%(message)s", handlers=handlers)
    cv2.setNumThreads(1)
    stop = threading.Event()
    watch = threading.Thread(target=_end_with_service, args=(connection, stop, job), daemon=True)
    watch.start()
    try:
        camera = job.task.recipe()
        CameraLoop(camera, RingWriter(job.ring, job.task.pace), job, outbox.tell, stop).run()
    except UserFacingError as error:
        outbox.tell(Ended(error))


def _end_with_service(connection: "Connection[Any, Any]", stop: threading.Event, job: Job) -> None:
    """Body of the thread that waits for the service to say "end", or to be gone."""
    limits = job.task.limits
    is_over = False
    while not is_over:
        # The kernel's alarm clock ends the process if nobody sets it again: native code that hangs
        # while it holds Python's lock stops this thread too.
        signal.setitimer(signal.ITIMER_REAL, limits.orphan_s)
        is_over = connection.poll(limits.orphan_s / 3)
    stop.set()
    threading.main_thread().join(limits.closing_s)
    os._exit(1)


class _Outbox:
    """Words for the service, from any thread."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._lock = threading.Lock()

    def tell(self, word: Word) -> None:
        """Send it; a service that is gone hears nothing, and `_end_with_service` sees to that."""
        with suppress(OSError), self._lock:
            self._connection.send(word)


class _LogToService(logging.Handler):
    def __init__(self, outbox: _Outbox) -> None:
        super().__init__()
        self._outbox = outbox

    def emit(self, record: logging.LogRecord) -> None:
        self._outbox.tell(LogLine(record.levelno, record.name, self.format(record)))


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

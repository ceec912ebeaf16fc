"""The recorder's process: ``python -m vo_service.recorder.child FD``, started by `Keeper`.

It does all encoding and writing, at low priority. When its pipe ends without an `End` the service
has crashed: it then writes out the ring by itself, and ends.
"""

import os
import signal
import sys
import threading
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2

from vo_service.recorder.desk import Desk
from vo_service.recorder.messages import End, IncidentWritten, Job, Word

FACTS_EVERY_S = 1.0
NICE = 10
# The service can do without this process, so that is the one to end where memory runs out.
OOM_SCORE = "800"
# What a terminal, systemd or its watchdog may send to every process of the service when it stops.
_NOT_FOR_US = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says `End` or is gone."""
    for number in _NOT_FOR_US:
        signal.signal(number, signal.SIG_IGN)
    os.umask(0o077)  # pictures of where the robot was are nobody else's business
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    cv2.setNumThreads(1)
    outbox = _Outbox(connection)
    with suppress(EOFError, OSError):  # gone before it said what to do
        job: Job = connection.recv()
        desk = Desk(job, outbox.tell)
        if _serve(connection, desk, outbox):
            desk.finish()
        else:
            desk.rescue()


def _serve(connection: "Connection[Any, Any]", desk: Desk, outbox: "_Outbox") -> bool:
    """Carry out orders until the service ends; whether it did so in order."""
    while True:
        outbox.tell(desk.facts)
        try:
            order = connection.recv() if connection.poll(FACTS_EVERY_S) else None
        except (EOFError, OSError):
            outbox.service_is_gone()
            return False
        if isinstance(order, End):
            return True
        if order is not None:
            desk.take(order)


class _Outbox:
    """Words for the service, from any thread; for the log when it is gone."""

    def __init__(self, connection: "Connection[Any, Any]") -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._is_heard = True

    def tell(self, word: Word) -> None:
        """Send it."""
        with self._lock:
            if self._is_heard:
                with suppress(OSError):
                    self._connection.send(word)
            elif isinstance(word, IncidentWritten):
                print(_last_words(word), file=sys.stderr, flush=True)

    def service_is_gone(self) -> None:
        """From now on nobody listens."""
        with self._lock:
            self._is_heard = False


def _last_words(word: IncidentWritten) -> str:
    if word.trouble:
        return f"kinect-vo: error: recorder: the frames before the crash are lost: {word.trouble}"
    return (
        "kinect-vo: warning: recorder: the service ended without notice; its last "
        f"{word.frames} frames are in {word.folder}"
    )


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

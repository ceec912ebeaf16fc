"""The recorder's process: ``python -m vo_service.recorder.child FD``, started by `Keeper`.

It does all encoding and writing, at low priority. When its pipe ends without an `End` the service
has crashed: it then writes out the ring by itself, and ends.
"""

import os
import signal
import sys
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import cv2

from drivers.isolation.outbox import Outbox, leave_signals_to_service, log_to_service
from vo_service.recorder.desk import Desk
from vo_service.recorder.messages import End, IncidentWritten, Job, Word

FACTS_EVERY_S = 1.0
NICE = 10
# The service can do without this process, so that is the one to end where memory runs out.
OOM_SCORE = "800"
# What else a terminal, systemd or its watchdog may send to every process when the service stops.
_MORE_SIGNALS = (signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says `End` or is gone."""
    leave_signals_to_service(*_MORE_SIGNALS)
    os.umask(0o077)  # pictures of where the robot was are nobody else's business
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICE)
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(OOM_SCORE)
    cv2.setNumThreads(1)
    outbox = Outbox(connection)
    with suppress(EOFError, OSError):  # gone before it said what to do
        job: Job = connection.recv()
        log_to_service(outbox, job.log_level)
        desk = Desk(job, partial(_tell, outbox))
        if _serve(connection, desk, outbox):
            desk.finish()
        else:
            desk.rescue()


def _serve(connection: "Connection[Any, Any]", desk: Desk, outbox: Outbox) -> bool:
    """Carry out orders until the service ends; whether it did so in order."""
    while True:
        outbox.tell(desk.facts)
        try:
            order = connection.recv() if connection.poll(FACTS_EVERY_S) else None
        except (EOFError, OSError):
            return False
        if isinstance(order, End):
            return True
        if order is not None:
            desk.take(order)


def _tell(outbox: Outbox, word: Word) -> None:
    """What became of the last frames is said in the log if the service is gone."""
    if not outbox.tell(word) and isinstance(word, IncidentWritten):
        print(_last_words(word), file=sys.stderr, flush=True)


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

"""The recorder's process: ``python -m vo_service.recorder.child FD``, started by `Keeper`.

It does all encoding and writing, at low priority. When its pipe ends without an `End` the service
has crashed: it then writes out the ring by itself, and ends.
"""

import sys
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers.isolation.outbox import Outbox, log_to_service
from vo_service.background.child import step_back
from vo_service.background.messages import End
from vo_service.recorder.desk import Desk
from vo_service.recorder.messages import IncidentWritten, Job, Word

FACTS_EVERY_S = 1.0


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says `End` or is gone."""
    step_back()
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

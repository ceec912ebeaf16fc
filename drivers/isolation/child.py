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
from queue import SimpleQueue
from typing import Any

import cv2

from drivers.camera import RgbdCamera
from drivers.errors import CameraError, UserFacingError
from drivers.isolation.camera_loop import CameraLoop
from drivers.isolation.limits import TimeLimits
from drivers.isolation.messages import Ended, Job
from drivers.isolation.outbox import Outbox, leave_signals_to_service, log_to_service
from drivers.isolation.ring import RingWriter
from drivers.isolation.wishes import Wish

_log = logging.getLogger(__name__)


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says that this is the end, or is gone."""
    leave_signals_to_service()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_hear`
    job: Job = connection.recv()
    outbox = Outbox(connection)
    log_to_service(outbox, job.log_level)
    cv2.setNumThreads(1)
    stop = threading.Event()
    wishes: SimpleQueue[Wish] = SimpleQueue()
    listening = (connection, wishes, stop, job.task.limits)
    threading.Thread(target=_listen, args=listening, daemon=True).start()
    try:
        camera = job.task.recipe()
        for wish in job.wishes:
            with suppress(CameraError):  # it is not open yet: it remembers
                wish.grant(camera)
        threading.Thread(target=_grant, args=(wishes, camera), daemon=True).start()
        CameraLoop(camera, RingWriter(job.ring, job.task.pace), job, outbox.tell, stop).run()
    except UserFacingError as error:
        outbox.tell(Ended(error))


def _listen(
    connection: "Connection[Any, Any]",
    wishes: "SimpleQueue[Wish]",
    stop: threading.Event,
    limits: TimeLimits,
) -> None:
    """Body of the thread that hears the service's wishes, and ends the process with it."""
    with suppress(EOFError, OSError):
        while (wish := _hear(connection, limits)) is not None:
            wishes.put(wish)
    stop.set()
    threading.main_thread().join(limits.closing_s)
    os._exit(1)


def _grant(wishes: "SimpleQueue[Wish]", camera: RgbdCamera) -> None:
    """Body of the thread that does as it is told: neither frames nor the service wait for it."""
    while True:
        try:
            wishes.get().grant(camera)
        except CameraError as error:
            _log.warning("%s", error)


def _hear(connection: "Connection[Any, Any]", limits: TimeLimits) -> Wish | None:
    """The next wish; None at the end. Raises EOFError or OSError if the service is gone."""
    while True:
        # The kernel's alarm clock ends the process if nobody sets it again: native code that hangs
        # while it holds Python's lock stops this thread too.
        signal.setitimer(signal.ITIMER_REAL, limits.orphan_s)
        if connection.poll(limits.orphan_s / 3):
            wish: Wish | None = connection.recv()
            return wish


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

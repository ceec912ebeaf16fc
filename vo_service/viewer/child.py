"""The viewer's process: ``python -m vo_service.viewer.child FD``, started by `Supervisor`.

It ends with the service, whatever happens: in order where that is possible, by force where not.
"""

import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from drivers.errors import UserFacingError
from drivers.isolation.outbox import Outbox, leave_signals_to_service, log_to_service
from vo_service.settings import MEGABYTE
from vo_service.viewer.messages import Ended, Finish, Health, Job, Message, Ready
from vo_service.viewer.targets import prepare_rerun
from vo_service.viewer.wire import receive

if TYPE_CHECKING:
    from vo_service.viewer.drawing import Drawing

HEARTBEAT_S = 0.5
# One message that takes longer than this to draw is stuck in Rerun: the viewer takes no data.
STUCK_S = 2.0
# For writing out everything, once the service is gone.
FINISHING_S = 5.0
# Native code that holds Python's lock stops the heartbeat; after this long the kernel steps in.
ORPHAN_S = 20.0
# Poses come first where processors are scarce.
NICENESS = 5


def main(connection: "Connection[Any, Any]") -> None:
    """Draw until the service says that nothing follows, or is gone."""
    leave_signals_to_service()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_Pulse`
    job: Job = connection.recv()
    outbox = Outbox(connection)
    log_to_service(outbox, job.log_level)
    logging.getLogger("numexpr").setLevel(logging.WARNING)  # tells how many threads it has
    cv2.setNumThreads(1)
    pulse = _Pulse(job, outbox)
    try:
        _draw(_open_drawing(job), connection, pulse, outbox)
    except UserFacingError as error:
        outbox.tell(Ended(error))


def _open_drawing(job: Job) -> "Drawing":
    # Rerun is slow to import: the heart beats already.
    prepare_rerun()
    os.environ["RERUN_FLUSH_TICK_SECS"] = str(job.sink.batch_s)
    drawing = import_module("vo_service.viewer.drawing")
    opened: Drawing = drawing.Drawing(job)
    return opened


def _draw(
    drawing: "Drawing", connection: "Connection[Any, Any]", pulse: "_Pulse", outbox: Outbox
) -> None:
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(NICENESS)
    outbox.tell(Ready())
    for message in _messages(connection):
        with pulse.busy():
            drawing.draw(message)
        pulse.health = Health(drawing.trouble, drawing.incomplete)
    with pulse.busy():
        drawing.finish()
    outbox.tell(Health(drawing.trouble, drawing.incomplete))


def _messages(connection: "Connection[Any, Any]") -> Iterator[Message]:
    """Until the service says that nothing follows, or is gone."""
    with suppress(EOFError, OSError):
        while not isinstance(message := receive(connection), Finish):
            yield message


class _Pulse:
    """A thread that tells the service how it goes, and ends the process where that must be."""

    def __init__(self, job: Job, outbox: Outbox) -> None:
        self._job, self._outbox = job, outbox
        self._busy_since_s = float("inf")
        self.health = Health()
        threading.Thread(target=self._run, name="pulse", daemon=True).start()

    @contextmanager
    def busy(self) -> Iterator[None]:
        """While something is drawn."""
        self._busy_since_s = time.monotonic()
        yield
        self._busy_since_s = float("inf")

    def _run(self) -> None:
        while self._outbox.is_heard:
            signal.setitimer(signal.ITIMER_REAL, ORPHAN_S)
            if _resident_mb() > self._job.memory_mb:
                self._outbox.tell(Ended(UserFacingError(self._too_large())))
                os._exit(1)
            self._outbox.tell(self._health_now())
            time.sleep(HEARTBEAT_S)
        time.sleep(FINISHING_S)
        os._exit(1)

    def _health_now(self) -> Health:
        if time.monotonic() - self._busy_since_s < STUCK_S:
            return self.health
        return replace(self.health, trouble=f"{self._job.sink.address} does not take its data")

    def _too_large(self) -> str:
        return (
            f"the viewer's process passed {self._job.memory_mb} MB (rerun.memory_mb), "
            "as its data is not taken fast enough; starting it again"
        )


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MEGABYTE


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)
    os._exit(0)  # Rerun's threads may never end

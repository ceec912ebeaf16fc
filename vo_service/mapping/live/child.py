"""The mapper's process: ``python -m vo_service.mapping.live.child FD``, started by `Keeper`.

It keeps the keyframes, at low priority; for each map that is asked for it makes another process.
"""

import math
import sys
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from drivers.isolation.outbox import Outbox, log_to_service
from vo_service.background.child import step_back
from vo_service.background.messages import End
from vo_service.mapping.live.desk import Desk
from vo_service.mapping.live.messages import Job

FACTS_EVERY_S = 1.0
LOOK_EVERY_S = 0.2


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says `End` or is gone; what is being made then is given up."""
    step_back()
    outbox = Outbox(connection)
    with suppress(EOFError, OSError):  # also: gone before it said what to do
        job: Job = connection.recv()
        log_to_service(outbox, job.log_level)
        desk = Desk(job, outbox.tell, connection.close)
        try:
            _serve(connection, desk, outbox)
        finally:
            desk.give_up()


def _serve(connection: "Connection[Any, Any]", desk: Desk, outbox: Outbox) -> None:
    """Take in keyframes and orders until `End`. Raises EOFError or OSError without a service."""
    told_s = -math.inf
    while outbox.is_heard:
        is_due = time.monotonic() - told_s >= FACTS_EVERY_S
        if desk.take_in() or is_due:
            told_s = time.monotonic()
            outbox.tell(desk.facts)
        ready = wait([connection, *desk.sources], LOOK_EVERY_S)
        if connection in ready:
            order = connection.recv()
            if isinstance(order, End):
                return
            desk.take_in()  # what came before the order counts
            desk.take(order)
        elif ready:
            desk.tell_ended()


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

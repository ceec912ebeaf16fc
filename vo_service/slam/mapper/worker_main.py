"""The main function of the mapper's process; see `vo_service.mapper_process`.

It keeps the keyframes, at low priority; for each map that is asked for it makes another process.
"""

import math
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from drivers.core.process.background import configure_background_process
from drivers.core.process.messages import Shutdown
from drivers.core.process.parent_connection import ParentConnection, forward_logs
from vo_service.slam.mapper.mapper_worker import MapperWorker
from vo_service.slam.mapper.mesh_job import FuseKeyframes
from vo_service.slam.mapper.messages import MapperWorkerConfig

STATUS_PERIOD_S = 1.0
POLL_PERIOD_S = 0.2


def run_mapper(connection: "Connection[Any, Any]", fuse_keyframes: FuseKeyframes) -> None:
    """Work until the service says `Shutdown` or is gone; what is being made then is given up."""
    configure_background_process()
    outbox = ParentConnection(connection)
    with suppress(EOFError, OSError):  # also: gone before it said what to do
        job: MapperWorkerConfig = connection.recv()
        forward_logs(outbox, job.log_level)
        desk = MapperWorker(job, outbox.send, connection.close, fuse_keyframes)
        try:
            _serve(connection, desk, outbox)
        finally:
            desk.cancel_jobs()


def _serve(
    connection: "Connection[Any, Any]", worker: MapperWorker, parent: ParentConnection
) -> None:
    """Take in keyframes and orders until `Shutdown`. Raises EOFError or OSError without a service."""
    told_s = -math.inf
    while parent.is_connected:
        is_due = time.monotonic() - told_s >= STATUS_PERIOD_S
        if worker.process_frames() or is_due:
            told_s = time.monotonic()
            parent.send(worker.status)
        ready = wait([connection, *worker.result_connections], POLL_PERIOD_S)
        if connection in ready:
            order = connection.recv()
            if isinstance(order, Shutdown):
                return
            worker.process_frames()  # what came before the order counts
            worker.handle(order)
        elif ready:
            worker.send_job_results()

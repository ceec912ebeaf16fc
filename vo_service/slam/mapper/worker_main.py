"""The main function of the mapper's process; see `vo_service.mapper_process`.

It is started by `WorkerSupervisor` and runs at low priority. Each mesh is built in another process.
"""

import math
import time
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from drivers.core.process.background import configure_background_process
from drivers.core.process.parent_connection import ParentConnection, forward_logs
from drivers.core.process.worker_process import Shutdown
from vo_service.slam.mapper.mapper_worker import MapperWorker
from vo_service.slam.mapper.mesh_job import FuseKeyframes
from vo_service.slam.mapper.messages import MapperWorkerConfig

STATUS_PERIOD_S = 1.0
POLL_PERIOD_S = 0.2


def run_mapper(connection: "Connection[Any, Any]", fuse_keyframes: FuseKeyframes) -> None:
    """Run until `Shutdown` or the end of the service; a running mesh job is cancelled."""
    configure_background_process()
    parent = ParentConnection(connection)
    with suppress(EOFError, OSError):  # the service is gone
        config: MapperWorkerConfig = connection.recv()
        forward_logs(parent, config.log_level)
        worker = MapperWorker(config, parent.send, connection.close, fuse_keyframes)
        try:
            _serve(connection, worker, parent)
        finally:
            worker.cancel_jobs()


def _serve(
    connection: "Connection[Any, Any]", worker: MapperWorker, parent: ParentConnection
) -> None:
    """Run until `Shutdown`. Raises EOFError or OSError if the service is gone."""
    last_status_s = -math.inf
    while parent.is_connected:
        is_due = time.monotonic() - last_status_s >= STATUS_PERIOD_S
        if worker.process_frames() or is_due:
            last_status_s = time.monotonic()
            parent.send(worker.status)
        ready = wait([connection, *worker.result_connections], POLL_PERIOD_S)
        if connection in ready:
            request = connection.recv()
            if isinstance(request, Shutdown):
                return
            worker.process_frames()  # frames before the request
            worker.handle(request)
        elif ready:
            worker.send_job_results()

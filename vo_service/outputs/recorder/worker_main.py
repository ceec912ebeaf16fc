"""The recorder's process: ``python -m vo_service.outputs.recorder.worker_main FD``.

`WorkerSupervisor` starts it. It encodes and writes at low priority. If its pipe closes without a
`Shutdown`, the service has crashed; the process then writes the ring to disk and exits.
"""

import sys
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.process.background import configure_background_process
from drivers.core.process.parent_connection import ParentConnection, forward_logs
from drivers.core.process.worker_process import Shutdown
from vo_service.outputs.recorder.messages import (
    IncidentResult,
    RecorderMessage,
    RecorderWorkerConfig,
)
from vo_service.outputs.recorder.recorder_worker import RecorderWorker

STATUS_PERIOD_S = 1.0


def main(connection: "Connection[Any, Any]") -> None:
    """Handle requests until the service sends `Shutdown` or ends."""
    configure_background_process()
    parent = ParentConnection(connection)
    with suppress(EOFError, OSError):  # the service ended before it sent the configuration
        config: RecorderWorkerConfig = connection.recv()
        forward_logs(parent, config.log_level)
        worker = RecorderWorker(config, partial(_send, parent))
        if _serve(connection, worker, parent):
            worker.finish()
        else:
            worker.dump_after_crash()


def _serve(
    connection: "Connection[Any, Any]", worker: RecorderWorker, parent: ParentConnection
) -> bool:
    """Handle requests until the service ends; return whether it sent `Shutdown`."""
    while True:
        parent.send(worker.status)
        try:
            request = connection.recv() if connection.poll(STATUS_PERIOD_S) else None
        except (EOFError, OSError):
            return False
        if isinstance(request, Shutdown):
            return True
        if request is not None:
            worker.handle(request)


def _send(parent: ParentConnection, message: RecorderMessage) -> None:
    """Send a message; if the service is gone, print an incident's result."""
    if not parent.send(message) and isinstance(message, IncidentResult):
        print(_crash_message(message), file=sys.stderr, flush=True)


def _crash_message(result: IncidentResult) -> str:
    if result.error:
        return f"kinect-vo: error: recorder: the frames before the crash are lost: {result.error}"
    return (
        "kinect-vo: warning: recorder: the service crashed; its last "
        f"{result.frame_count} frames are in {result.folder}"
    )


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

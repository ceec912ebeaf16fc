"""The recorder's process: ``python -m vo_service.outputs.recorder.worker_main FD``, started by `Keeper`.

It does all encoding and writing, at low priority. When its pipe ends without an `Shutdown` the service
has crashed: it then writes out the ring by itself, and ends.
"""

import sys
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

from drivers.core.process.background import configure_background_process
from drivers.core.process.messages import Shutdown
from drivers.core.process.parent_connection import ParentConnection, forward_logs
from vo_service.outputs.recorder.messages import (
    IncidentResult,
    RecorderMessage,
    RecorderWorkerConfig,
)
from vo_service.outputs.recorder.recorder_worker import RecorderWorker

STATUS_PERIOD_S = 1.0


def main(connection: "Connection[Any, Any]") -> None:
    """Work until the service says `Shutdown` or is gone."""
    configure_background_process()
    outbox = ParentConnection(connection)
    with suppress(EOFError, OSError):  # gone before it said what to do
        job: RecorderWorkerConfig = connection.recv()
        forward_logs(outbox, job.log_level)
        desk = RecorderWorker(job, partial(_send, outbox))
        if _serve(connection, desk, outbox):
            desk.finish()
        else:
            desk.dump_after_crash()


def _serve(
    connection: "Connection[Any, Any]", worker: RecorderWorker, parent: ParentConnection
) -> bool:
    """Carry out orders until the service ends; whether it did so in order."""
    while True:
        parent.send(worker.status)
        try:
            order = connection.recv() if connection.poll(STATUS_PERIOD_S) else None
        except (EOFError, OSError):
            return False
        if isinstance(order, Shutdown):
            return True
        if order is not None:
            worker.handle(order)


def _send(parent: ParentConnection, message: RecorderMessage) -> None:
    """What became of the last frames is said in the log if the service is gone."""
    if not parent.send(message) and isinstance(message, IncidentResult):
        print(_crash_message(message), file=sys.stderr, flush=True)


def _crash_message(result: IncidentResult) -> str:
    if result.error:
        return f"kinect-vo: error: recorder: the frames before the crash are lost: {result.error}"
    return (
        "kinect-vo: warning: recorder: the service ended without notice; its last "
        f"{result.frame_count} frames are in {result.folder}"
    )


if __name__ == "__main__":
    with Connection(int(sys.argv[1])) as _connection:
        main(_connection)

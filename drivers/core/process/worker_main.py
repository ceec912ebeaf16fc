"""The program of all workers: ``python -m drivers.core.process.worker_main MODULE:FUNCTION FD``.

`WorkerProcess` starts it. It always ends with the service, by force if necessary.
"""

import logging
import os
import signal
import sys
import traceback
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.memory import release_memory
from drivers.core.process.messages import StartWorker, WorkerFailed, receive_message
from drivers.core.process.service_connection import ForwardingHandler, ServiceConnection
from drivers.core.process.worker_spec import WorkerSpec

# They reach every process of a terminal or a unit, but only the service handles them.
_IGNORED_SIGNALS = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT,
)  # fmt: skip


def main(function: str, fd: int) -> None:
    """Run a worker's function until it returns, and end the process."""
    for number in _IGNORED_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    code = 1
    try:
        _run(function, Connection(fd))
        code = 0
    except EOFError:
        pass  # the service ended before it sent the first message
    except SystemExit as end:
        print(end.code, file=sys.stderr)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # native threads may never end


def _run(function: str, connection: "Connection[object, object]") -> None:
    start: StartWorker = receive_message(connection)
    service = ServiceConnection(connection, start.spec, start.config)
    logging.basicConfig(
        level=start.log_level, format="%(message)s", handlers=[ForwardingHandler(service)]
    )
    module, _, name = function.partition(":")
    # Before cv2: a module may set what the libraries read when they are loaded.
    run = getattr(import_module(module), name)
    release_memory()  # of the import
    _lower_priority(start.spec)
    try:
        run(service)
    except UserFacingError as error:
        service.send(WorkerFailed(error))


def _lower_priority(spec: WorkerSpec) -> None:
    with suppress(OSError):  # a hardened unit forbids it
        os.nice(spec.nice)
    if spec.oom_score_adj is not None:
        set_oom_score(spec.oom_score_adj)


def set_oom_score(score: int) -> None:
    """Set how readily the kernel kills this process when memory runs out: at most 1000."""
    with suppress(OSError):
        Path("/proc/self/oom_score_adj").write_text(str(score))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))

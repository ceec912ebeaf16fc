"""Worker process of one run, started by `run_in_subprocess`.

Run as ``python -m vo_service.tools.benchmark.worker_main FD``. It always ends with its parent,
by force if needed.
"""

import vo_service.tools.benchmark.single_thread  # noqa: F401

# isort: split

import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

import cv2

from drivers.core.errors import UserFacingError
from drivers.core.process.parent_connection import (
    ParentConnection,
    forward_logs,
    ignore_terminal_signals,
)
from vo_service.tools.benchmark.run import RunOutcome, RunState
from vo_service.tools.benchmark.runner import KernelsCompiledFirst, run_method
from vo_service.tools.benchmark.subprocess_run import KernelsCompiled, RunMessage, RunRequest

# Native code that holds Python's lock blocks all threads; SIGALRM ends the process after this time.
ORPHAN_TIMEOUT_S = 60.0


def main(connection: "Connection[Any, Any]") -> None:
    """Receive one request, run it and send the outcome."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_exit_with_parent`
    request: RunRequest = connection.recv()
    parent = ParentConnection(connection)
    forward_logs(parent, request.log_level)
    pin_to_one_cpu()
    cv2.setNumThreads(1)
    watchdog = threading.Thread(target=_exit_with_parent, args=(connection,), daemon=True)
    watchdog.start()

    def send(message: RunMessage) -> None:
        parent.send(message)

    send(run_request(request, send))


def pin_to_one_cpu() -> None:
    """Pin the process to one CPU, because some libraries start a thread per CPU."""
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {allowed[os.getpid() % len(allowed)]})


def run_request(
    request: RunRequest, send: Callable[[RunMessage], None]
) -> RunOutcome | KernelsCompiled:
    """Run a method and convert its exceptions to an outcome."""
    try:
        return RunOutcome(RunState.DONE, run_method(request, send))
    except KernelsCompiledFirst:
        return KernelsCompiled()
    except UserFacingError as error:
        return RunOutcome(RunState.FAILED, error=str(error))
    except Exception as error:
        location = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        message = f"{text} ({os.path.basename(location.filename)}:{location.lineno})"  # noqa: PTH119
        return RunOutcome(RunState.ERROR, error=message, details=traceback.format_exc())


def _exit_with_parent(connection: "Connection[Any, Any]") -> None:
    """Exit when the parent process has ended; runs in a thread."""
    with suppress(EOFError, OSError):
        while True:
            signal.setitimer(signal.ITIMER_REAL, ORPHAN_TIMEOUT_S)
            if connection.poll(ORPHAN_TIMEOUT_S / 3):
                connection.recv()  # nothing follows the request but the end of file
    os._exit(1)


if __name__ == "__main__":
    main(Connection(int(sys.argv[1])))
    os._exit(0)

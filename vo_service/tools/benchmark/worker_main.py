"""The process of one run: ``python -m vo_service.tools.benchmark.worker_main FD``, started by `run_in_subprocess`.

It ends with the program that started it, whatever happens: in order where that is possible, by
force where not.
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
from vo_service.tools.benchmark.messages import KernelsCompiled, RunMessage, RunRequest
from vo_service.tools.benchmark.run import RunOutcome, RunState
from vo_service.tools.benchmark.runner import KernelsCompiledFirst, run_method

# Native code that holds Python's lock stops every thread; after so long the kernel steps in.
ORPHAN_TIMEOUT_S = 60.0


def main(connection: "Connection[Any, Any]") -> None:
    """Follow one folder and tell the outcome."""
    ignore_terminal_signals()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_exit_with_parent`
    job: RunRequest = connection.recv()
    outbox = ParentConnection(connection)
    forward_logs(outbox, job.log_level)
    pin_to_one_cpu()
    cv2.setNumThreads(1)
    watching = threading.Thread(target=_exit_with_parent, args=(connection,), daemon=True)
    watching.start()

    def tell(word: RunMessage) -> None:
        outbox.send(word)

    tell(run_request(job, tell))


def pin_to_one_cpu() -> None:
    """Libraries that ask nobody how many threads to make then make one."""
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {allowed[os.getpid() % len(allowed)]})


def run_request(
    request: RunRequest, send: Callable[[RunMessage], None]
) -> RunOutcome | KernelsCompiled:
    """Whatever a method raises is an outcome."""
    try:
        return RunOutcome(RunState.DONE, run_method(request, send))
    except KernelsCompiledFirst:
        return KernelsCompiled()
    except UserFacingError as error:
        return RunOutcome(RunState.FAILED, error=str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        trouble = f"{text} ({os.path.basename(where.filename)}:{where.lineno})"  # noqa: PTH119
        return RunOutcome(RunState.ERROR, error=trouble, details=traceback.format_exc())


def _exit_with_parent(connection: "Connection[Any, Any]") -> None:
    """Body of the thread that ends the process when the program that started this one is gone."""
    with suppress(EOFError, OSError):
        while True:
            signal.setitimer(signal.ITIMER_REAL, ORPHAN_TIMEOUT_S)
            if connection.poll(ORPHAN_TIMEOUT_S / 3):
                connection.recv()  # nothing follows the job: this is the end
    os._exit(1)


if __name__ == "__main__":
    main(Connection(int(sys.argv[1])))
    os._exit(0)

"""The process of one run: ``python -m vo_service.runs.child FD``, started by `run_in_child`.

It ends with the program that started it, whatever happens: in order where that is possible, by
force where not.
"""

import vo_service.runs.one_thread  # noqa: F401

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

from drivers.errors import UserFacingError
from drivers.isolation.outbox import Outbox, leave_signals_to_service, log_to_service
from vo_service.runs.following import CompiledFirst, follow
from vo_service.runs.messages import Compiled, Job, Word
from vo_service.runs.run import Outcome, RunState

# Native code that holds Python's lock stops every thread; after so long the kernel steps in.
ORPHAN_S = 60.0


def main(connection: "Connection[Any, Any]") -> None:
    """Follow one folder and tell the outcome."""
    leave_signals_to_service()
    signal.signal(signal.SIGALRM, signal.SIG_DFL)  # see `_end_with_the_program`
    job: Job = connection.recv()
    outbox = Outbox(connection)
    log_to_service(outbox, job.log_level)
    stay_on_one_processor()
    cv2.setNumThreads(1)
    watching = threading.Thread(target=_end_with_the_program, args=(connection,), daemon=True)
    watching.start()

    def tell(word: Word) -> None:
        outbox.tell(word)

    tell(outcome_of(job, tell))


def stay_on_one_processor() -> None:
    """Libraries that ask nobody how many threads to make then make one."""
    allowed = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {allowed[os.getpid() % len(allowed)]})


def outcome_of(job: Job, tell: Callable[[Word], None]) -> Outcome | Compiled:
    """Whatever a method raises is an outcome."""
    try:
        return Outcome(RunState.DONE, follow(job, tell))
    except CompiledFirst:
        return Compiled()
    except UserFacingError as error:
        return Outcome(RunState.REFUSED, trouble=str(error))
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        trouble = f"{text} ({os.path.basename(where.filename)}:{where.lineno})"  # noqa: PTH119
        return Outcome(RunState.RAISED, trouble=trouble, details=traceback.format_exc())


def _end_with_the_program(connection: "Connection[Any, Any]") -> None:
    """Body of the thread that ends the process when the program that started this one is gone."""
    with suppress(EOFError, OSError):
        while True:
            signal.setitimer(signal.ITIMER_REAL, ORPHAN_S)
            if connection.poll(ORPHAN_S / 3):
                connection.recv()  # nothing follows the job: this is the end
    os._exit(1)


if __name__ == "__main__":
    main(Connection(int(sys.argv[1])))
    os._exit(0)

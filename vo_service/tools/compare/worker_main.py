"""Worker process of one run, started by `run_in_subprocess`."""

import vo_service.tools.compare.single_thread  # noqa: F401

# isort: split

import os
import threading
import traceback
from collections.abc import Callable

from drivers.core import UserFacingError
from drivers.core.process.service_connection import ServiceConnection
from vo_service.tools.compare.batch import KernelsCompiled, RunMessage, RunRequest
from vo_service.tools.compare.run_outcome import CompletedRun, RunOutcome, RunState
from vo_service.tools.compare.runner import run_method


def run_comparison(program: ServiceConnection) -> None:
    """Run the one request and send the outcome."""
    request: RunRequest = program.config
    threading.Thread(target=_exit_with_parent, args=(program,), daemon=True).start()
    pin_to_one_cpu()

    def send(message: RunMessage) -> None:
        program.send(message)

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
        result = run_method(request, send)
        return RunOutcome(RunState.DONE, result) if isinstance(result, CompletedRun) else result
    except UserFacingError as error:
        return RunOutcome(RunState.FAILED, error=str(error))
    except Exception as error:
        location = traceback.extract_tb(error.__traceback__)[-1]
        text = " ".join(f"{type(error).__name__}: {error}".split())
        message = f"{text} ({os.path.basename(location.filename)}:{location.lineno})"  # noqa: PTH119
        return RunOutcome(RunState.ERROR, error=message, details=traceback.format_exc())


def _exit_with_parent(program: ServiceConnection) -> None:
    """Exit when the parent process has ended; runs in a thread."""
    program.stop.wait()
    os._exit(1)

"""One run in a process of its own, where it may crash or hang without harm to the others."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.core.errors import UserFacingError
from drivers.core.process.messages import LogMessage
from drivers.core.process.worker_process import WorkerProcess, WorkerSpec
from vo_service.tools.benchmark.messages import (
    KernelsCompiled,
    RunMessage,
    RunPreparing,
    RunProgress,
    RunRequest,
)
from vo_service.tools.benchmark.run import RunOutcome, RunState

RUN_WORKER = WorkerSpec("vo_service.tools.benchmark.worker_main", "run")
POLL_PERIOD_S = 0.25
SHUTDOWN_TIMEOUT_S = 5.0


def run_in_subprocess(
    request: RunRequest,
    time_limit_s: float,
    on_progress: Callable[[RunPreparing | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome:
    """Run to the end, for at most `limit_s`; a set `stop` ends it at once, without a result.

    Where kernels have to be compiled first, that is done in a process of its own.
    Raises UserFacingError if no process can be started.
    """
    last_word = _run_once(request, time_limit_s, on_progress, stop)
    if isinstance(last_word, KernelsCompiled):
        last_word = _run_once(
            replace(request, stop_after_compiling=False), time_limit_s, on_progress, stop
        )
    assert isinstance(last_word, RunOutcome)
    return last_word


def _run_once(
    request: RunRequest,
    time_limit_s: float,
    on_progress: Callable[[RunPreparing | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome | KernelsCompiled:
    """The last word of a process, or how it ended without one."""
    try:
        with WorkerProcess(RUN_WORKER, (), SHUTDOWN_TIMEOUT_S) as child:
            child.send(request)
            last_word = _receive_outcome(child, time_limit_s, on_progress, stop)
    except OSError as error:
        raise UserFacingError(
            f"a process for the run cannot be started: {error.strerror}; see to memory and limits"
        ) from error
    return last_word or RunOutcome(RunState.CRASHED, error=child.exit_reason)


def _receive_outcome(
    worker: WorkerProcess,
    time_limit_s: float,
    on_progress: Callable[[RunPreparing | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome | KernelsCompiled | None:
    """Listen until it has its last word; None if it ended without one."""
    due_s = time.monotonic() + time_limit_s
    while not stop.is_set():
        left_s = due_s - time.monotonic()
        if left_s <= 0:
            worker.kill()
            trouble = f"took longer than {time_limit_s:g} s (--time-limit)"
            return RunOutcome(RunState.TIMED_OUT, error=trouble)
        try:
            word: RunMessage | None = worker.receive(min(POLL_PERIOD_S, left_s))
        except EOFError:
            return None
        match word:
            case RunOutcome() | KernelsCompiled():
                return word
            case LogMessage(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
            case RunPreparing() | RunProgress():
                on_progress(word)
    worker.kill()
    return RunOutcome(RunState.NOT_RUN, error="stopped before its end")

"""Run in a subprocess, where it may crash or hang without harm to other runs."""

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace

from drivers.core.errors import UserFacingError
from drivers.core.process.worker_process import LogMessage, WorkerProcess, WorkerSpec
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
    """Run a method in a subprocess.

    If kernels have to be compiled, this happens in another subprocess before.

    Args:
        request: The run.
        time_limit_s: The run is killed after this time.
        on_progress: Is called with each progress message.
        stop: If set, the run is killed and has no result.

    Raises:
        UserFacingError: No process can be started.
    """
    result = _run_once(request, time_limit_s, on_progress, stop)
    if isinstance(result, KernelsCompiled):
        result = _run_once(
            replace(request, stop_after_compiling=False), time_limit_s, on_progress, stop
        )
    assert isinstance(result, RunOutcome)
    return result


def _run_once(
    request: RunRequest,
    time_limit_s: float,
    on_progress: Callable[[RunPreparing | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome | KernelsCompiled:
    """Return the last message of a worker, or how it ended without one."""
    try:
        with WorkerProcess(RUN_WORKER, (), SHUTDOWN_TIMEOUT_S) as worker:
            worker.send(request)
            result = _receive_outcome(worker, time_limit_s, on_progress, stop)
    except OSError as error:
        raise UserFacingError(
            f"the process of a run cannot be started: {error.strerror}; check memory and limits"
        ) from error
    return result or RunOutcome(RunState.CRASHED, error=worker.exit_reason)


def _receive_outcome(
    worker: WorkerProcess,
    time_limit_s: float,
    on_progress: Callable[[RunPreparing | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome | KernelsCompiled | None:
    """Receive messages until the last one; None if the worker ended without it."""
    deadline_s = time.monotonic() + time_limit_s
    while not stop.is_set():
        remaining_s = deadline_s - time.monotonic()
        if remaining_s <= 0:
            worker.kill()
            error = f"took longer than {time_limit_s:g} s (--time-limit)"
            return RunOutcome(RunState.TIMED_OUT, error=error)
        try:
            message: RunMessage | None = worker.receive(min(POLL_PERIOD_S, remaining_s))
        except EOFError:
            return None
        match message:
            case RunOutcome() | KernelsCompiled():
                return message
            case LogMessage(level, logger, text):
                logging.getLogger(logger).log(level, "%s", text)
            case RunPreparing() | RunProgress():
                on_progress(message)
    worker.kill()
    return RunOutcome(RunState.NOT_RUN, error="stopped before its end")

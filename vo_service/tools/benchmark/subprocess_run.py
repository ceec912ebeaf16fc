"""Run in a subprocess, where it may crash or hang without harm to other runs."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.core.errors import UserFacingError
from drivers.core.process import WorkerProcess, WorkerSpec
from drivers.recording.recording import ImageTopics
from vo_service.tools.benchmark.methods import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.recordings import ALL_FRAMES, FrameSelection
from vo_service.tools.benchmark.run import RunOutcome, RunState

RUN_WORKER = WorkerSpec(
    "vo_service.tools.benchmark.worker_main:run_benchmark",
    "run",
    exit_timeout_s=5.0,
    orphan_timeout_s=60.0,
)
POLL_PERIOD_S = 0.25


@dataclass(frozen=True)
class RunRequest:
    """Request to the worker, sent once: run a method on a recording.

    Attributes:
        folder: The recording.
        camera_file: As for `open_recording`.
        topics: As for `open_recording`.
        factory: Makes the method.
        frame_selection: Frames to use.
        stop_after_compiling: If kernels had to be compiled, end with `KernelsCompiled`.
        observer_factory: Makes the observer of the run.
    """

    folder: Path
    camera_file: Path | None
    factory: MethodFactory
    frame_selection: FrameSelection = ALL_FRAMES
    stop_after_compiling: bool = True
    observer_factory: ObserverFactory = NULL_OBSERVER
    topics: ImageTopics | None = None

    @property
    def fds(self) -> tuple[int, ...]:
        """No file descriptors."""
        return ()


@dataclass(frozen=True)
class RunPreparing:
    """Message of the worker: the current stage of compilation, loading or warm-up."""

    stage: str


@dataclass(frozen=True)
class RunProgress:
    """Message of the worker: number of processed frames."""

    done: int
    total: int


@dataclass(frozen=True)
class KernelsCompiled:
    """Last message of a worker that had to compile kernels, so its memory use is not the method's.

    The kernels are cached for the next process.
    """


# The last message is one of the last two types.
RunMessage = RunPreparing | RunProgress | KernelsCompiled | RunOutcome


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
        with WorkerProcess(RUN_WORKER, request) as worker:
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
            case RunPreparing() | RunProgress():
                on_progress(message)
    worker.kill()
    return RunOutcome(RunState.NOT_RUN, error="stopped before its end")

"""Runs of every method on every recording in subprocesses, with a cache of earlier results."""

import logging
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.core import UserFacingError
from drivers.core.process.worker_process import WorkerProcess
from drivers.core.process.worker_spec import WorkerSpec
from drivers.recording.recording import ImageTopics
from vo_service.terminal import Terminal
from vo_service.tools.compare.methods import MethodFactory
from vo_service.tools.compare.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.compare.recordings import ALL_FRAMES, BenchmarkRecording, FrameSelection
from vo_service.tools.compare.run_cache import RunCache, make_cache_key
from vo_service.tools.compare.run_outcome import RunOutcome, RunState
from vo_service.tools.compare.versions import collect_versions

RUN_WORKER = WorkerSpec(
    "vo_service.tools.compare.worker_main:run_comparison",
    "run",
    exit_timeout_s=5.0,
    orphan_timeout_s=60.0,
)
POLL_PERIOD_S = 0.25


@dataclass(frozen=True)
class RunRequest:
    """Request to the worker, sent once: run a method on a recording.

    Folder, camera file and topics are as for `open_recording`.

    Attributes:
        stop_after_compiling: If kernels had to be compiled, end with `KernelsCompiled`.
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
class RunProgress:
    """Message of the worker: number of processed frames."""

    done: int
    total: int


@dataclass(frozen=True)
class KernelsCompiled:
    """Last message of a worker that had to compile kernels, so its memory use is not the method's.

    The kernels are cached for the next process.
    """


# A text is the current stage of compilation, loading or warm-up. The last message is one of the
# last two types.
RunMessage = str | RunProgress | KernelsCompiled | RunOutcome


def run_in_subprocess(
    request: RunRequest,
    time_limit_s: float,
    on_progress: Callable[[str | RunProgress], None],
    stop: threading.Event,
) -> RunOutcome:
    """Run a method in a subprocess.

    If kernels have to be compiled, this happens in another subprocess before.

    Args:
        time_limit_s: The run is killed after this time.
        stop: If set, the run is killed and has no result.

    Raises:
        UserFacingError: No process can be started.
    """
    try:
        with WorkerProcess(RUN_WORKER, request) as worker:
            result = _receive_outcome(worker, time_limit_s, on_progress, stop)
    except OSError as error:
        raise UserFacingError(
            f"the process of a run cannot be started: {error.strerror}; check memory and limits"
        ) from error
    if isinstance(result, KernelsCompiled):
        compiled = replace(request, stop_after_compiling=False)
        return run_in_subprocess(compiled, time_limit_s, on_progress, stop)
    return result or RunOutcome(RunState.CRASHED, error=worker.exit_reason)


def _receive_outcome(
    worker: WorkerProcess,
    time_limit_s: float,
    on_progress: Callable[[str | RunProgress], None],
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
            case str() | RunProgress():
                on_progress(message)
    worker.kill()
    return RunOutcome(RunState.NOT_RUN, error="stopped before its end")


logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchPlan:
    """Runs of every method on every recording, each with a time limit.

    Attributes:
        factories: Method factories by the method's name.
        folder: Cache folder, with one folder per recording and in it one per method.
        force: Whether to re-run cached results.
    """

    recordings: Sequence[BenchmarkRecording]
    factories: Mapping[str, MethodFactory]
    folder: Path
    time_limit_s: float
    force: bool = False
    observer_factory: ObserverFactory = NULL_OBSERVER


def run_batch(
    plan: BatchPlan, terminal: Terminal, stop: threading.Event
) -> Iterator[tuple[BenchmarkRecording, Mapping[str, RunOutcome]]]:
    """Run what is not cached until `stop` is set; yield each recording with its runs by method.

    Failed runs are run again the next time. After a stop, the other runs come from the cache or
    are not run.

    Raises:
        UserFacingError: Results cannot be written, or no process can be started.
    """
    total, number = len(plan.recordings) * len(plan.factories), 0
    for recording in plan.recordings:
        outcomes = {}
        for method in plan.factories:
            number += 1
            label = f"{recording.name}, {method} (run {number} of {total})"
            outcomes[method] = _load_or_run(plan, recording, method, label, terminal, stop)
        yield recording, outcomes


def _load_or_run(
    plan: BatchPlan,
    recording: BenchmarkRecording,
    method: str,
    label: str,
    terminal: Terminal,
    stop: threading.Event,
) -> RunOutcome:
    """Load the outcome of one run from the cache, or run it."""
    factory, observer_factory = plan.factories[method], plan.observer_factory
    selection, versions = recording.frame_selection, collect_versions()
    cache = RunCache(plan.folder / recording.name / method)
    key = make_cache_key(recording, factory, versions, observer_factory)
    cached = cache.load(key)
    if cached is not None and cached.state is RunState.DONE and not plan.force:
        terminal.write_line(f"{label}: cached")
        return cached
    if stop.is_set():
        return cached or RunOutcome(RunState.NOT_RUN, error="stopped before its start")

    def show(message: str | RunProgress) -> None:
        if isinstance(message, RunProgress):
            terminal.progress(f"{label}: frame", message.done, message.total)
        else:
            terminal.show(f"{label}: preparing, {message}")

    terminal.show(f"{label}: starting")
    request = RunRequest(
        recording.folder,
        recording.camera_file,
        factory,
        selection,
        observer_factory=observer_factory,
        topics=recording.topics,
    )
    outcome = run_in_subprocess(request, plan.time_limit_s, show, stop)
    terminal.clear()
    if outcome.state is RunState.NOT_RUN:
        return cached or outcome
    description = {
        "recording": recording.name,
        "folder": str(recording.folder.resolve()),
        "every": selection.step,
        "first": selection.max_frames,
        "method": method,
        "settings": {**factory.settings, **observer_factory.settings},
        "versions": versions,
    }
    cache.save(key, outcome, description)
    if outcome.state is not RunState.DONE:
        logger.error("%s: %s", label, outcome)
        return outcome
    terminal.write_line(f"{label}: {outcome.run.cpu_s:.2f} s of processor time")
    return cache.load(key) or outcome  # the same rounded values as from the cache

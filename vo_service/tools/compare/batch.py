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
        time_limit_s: The run is killed after this time.
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


logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchPlan:
    """Runs of a batch.

    Attributes:
        recordings: Recordings to run on.
        factories: Method factories by the method's name.
        folder: Cache folder, with one folder per recording and in it one per method.
        time_limit_s: Time limit of each run.
        force: Whether to re-run cached results.
        observer_factory: Makes the observer of each run.
    """

    recordings: Sequence[BenchmarkRecording]
    factories: Mapping[str, MethodFactory]
    folder: Path
    time_limit_s: float
    force: bool = False
    observer_factory: ObserverFactory = NULL_OBSERVER


@dataclass(frozen=True)
class BatchResult:
    """One run and its outcome; `has_loop_closure` is True if loop closure was enabled."""

    recording: BenchmarkRecording
    method: str
    outcome: RunOutcome
    has_loop_closure: bool = False


def run_batch(plan: BatchPlan, terminal: Terminal, stop: threading.Event) -> Iterator[BatchResult]:
    """Run what is not cached until `stop` is set, and yield all results.

    Failed runs are run again the next time. After a stop, the other runs come from the cache or
    are not run.

    Raises:
        UserFacingError: Results cannot be written, or no process can be started.
    """
    total = len(plan.recordings) * len(plan.factories)
    number = 0
    for recording in plan.recordings:
        for method, factory in plan.factories.items():
            number += 1
            label = f"{recording.name}, {method} (run {number} of {total})"
            run = _PlannedRun(plan, recording, method, factory)
            outcome = run.load_or_run(label, terminal, stop)
            yield BatchResult(recording, method, outcome, bool(plan.observer_factory.settings))


@dataclass(frozen=True)
class _PlannedRun:
    """One run, loaded from the cache or executed."""

    plan: BatchPlan
    recording: BenchmarkRecording
    method: str
    factory: MethodFactory

    def load_or_run(self, label: str, terminal: Terminal, stop: threading.Event) -> RunOutcome:
        cache = RunCache(self.plan.folder / self.recording.name / self.method)
        key = make_cache_key(
            self.recording, self.factory, collect_versions(), self.plan.observer_factory
        )
        cached = cache.load(key)
        if cached is not None and cached.state is RunState.DONE and not self.plan.force:
            terminal.write_line(f"{label}: cached")
            return cached
        if stop.is_set():
            return cached or RunOutcome(RunState.NOT_RUN, error="stopped before its start")
        terminal.show(f"{label}: starting")
        outcome = run_in_subprocess(
            self._make_request(),
            self.plan.time_limit_s,
            _make_progress_callback(terminal, label),
            stop,
        )
        terminal.clear()
        if outcome.state is RunState.NOT_RUN:
            return cached or outcome
        cache.save(key, outcome, self._describe())
        if outcome.state is not RunState.DONE:
            logger.error("%s: %s", label, outcome)
            return outcome
        terminal.write_line(f"{label}: {outcome.run.cpu_s:.2f} s of processor time")
        return cache.load(key) or outcome  # the same rounded values as from the cache

    def _make_request(self) -> RunRequest:
        return RunRequest(
            self.recording.folder,
            self.recording.camera_file,
            self.factory,
            self.recording.frame_selection,
            observer_factory=self.plan.observer_factory,
            topics=self.recording.topics,
        )

    def _describe(self) -> dict[str, object]:
        return {
            "recording": self.recording.name,
            "folder": str(self.recording.folder.resolve()),
            "every": self.recording.frame_selection.step,
            "first": self.recording.frame_selection.max_frames,
            "method": self.method,
            "settings": {**self.factory.settings, **self.plan.observer_factory.settings},
            "versions": collect_versions(),
        }


def _make_progress_callback(
    terminal: Terminal, label: str
) -> Callable[[RunPreparing | RunProgress], None]:
    def show(message: RunPreparing | RunProgress) -> None:
        if isinstance(message, RunProgress):
            terminal.progress(f"{label}: frame", message.done, message.total)
        else:
            terminal.show(f"{label}: preparing, {message.stage}")

    return show

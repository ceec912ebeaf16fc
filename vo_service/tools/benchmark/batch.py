"""Runs of every method on every recording, with a cache of earlier results."""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vo_service.terminal import Terminal
from vo_service.tools.benchmark.methods import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.recordings import BenchmarkRecording
from vo_service.tools.benchmark.run import RunOutcome, RunState
from vo_service.tools.benchmark.run_cache import RunCache, make_cache_key
from vo_service.tools.benchmark.subprocess_run import (
    RunPreparing,
    RunProgress,
    RunRequest,
    run_in_subprocess,
)
from vo_service.tools.benchmark.versions import collect_versions

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

    Args:
        plan: The runs.
        terminal: Shows the progress.
        stop: Ends the batch.

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

"""Every method on every recording, one after another; what is kept already is not run again."""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vo_service.terminal import Terminal
from vo_service.tools.benchmark.cache_key import make_cache_key
from vo_service.tools.benchmark.messages import RunPreparing, RunProgress, RunRequest
from vo_service.tools.benchmark.method_factory import MethodFactory
from vo_service.tools.benchmark.observers import NULL_OBSERVER, ObserverFactory
from vo_service.tools.benchmark.recordings import BenchmarkRecording
from vo_service.tools.benchmark.run import RunOutcome, RunState
from vo_service.tools.benchmark.run_cache import RunCache
from vo_service.tools.benchmark.subprocess_run import run_in_subprocess
from vo_service.tools.benchmark.versions import collect_versions

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class BatchPlan:
    """What to run.

    recipes  by the method's name
    folder   where runs are kept, one folder a recording and in it one a method
    limit_s  for each run
    again    also what is kept
    listener who hears what the methods say, in each run
    """

    recordings: Sequence[BenchmarkRecording]
    factories: Mapping[str, MethodFactory]
    folder: Path
    time_limit_s: float
    force: bool = False
    observer_factory: ObserverFactory = NULL_OBSERVER


@dataclass(frozen=True)
class BatchResult:
    """One run, as it came out.

    has_loops  they were asked for
    """

    recording: BenchmarkRecording
    method: str
    outcome: RunOutcome
    has_loop_closure: bool = False


def run_batch(plan: BatchPlan, terminal: Terminal, stop: threading.Event) -> Iterator[BatchResult]:
    """Run what is not kept, until `stop` is set; the rest is then kept from before or not run.

    Only runs that came to their end are kept for good: one that failed is tried again the next
    time. Raises UserFacingError if results cannot be kept or no process can be started.
    """
    total = len(plan.recordings) * len(plan.factories)
    number = 0
    for recording in plan.recordings:
        for method, recipe in plan.factories.items():
            number += 1
            label = f"{recording.name}, {method} (run {number} of {total})"
            run = _PlannedRun(plan, recording, method, recipe)
            outcome = run.load_or_run(label, terminal, stop)
            yield BatchResult(recording, method, outcome, bool(plan.observer_factory.settings))


@dataclass(frozen=True)
class _PlannedRun:
    """One run: kept from before, or made."""

    plan: BatchPlan
    recording: BenchmarkRecording
    method: str
    factory: MethodFactory

    def load_or_run(self, label: str, terminal: Terminal, stop: threading.Event) -> RunOutcome:
        folder = RunCache(self.plan.folder / self.recording.name / self.method)
        key = make_cache_key(
            self.recording, self.factory, collect_versions(), self.plan.observer_factory
        )
        kept = folder.load(key)
        if kept is not None and kept.state is RunState.DONE and not self.plan.force:
            terminal.write_line(f"{label}: kept from before")
            return kept
        if stop.is_set():
            return kept or RunOutcome(RunState.NOT_RUN, error="stopped before it began")
        terminal.show(f"{label}: starting")
        outcome = run_in_subprocess(
            self._make_request(),
            self.plan.time_limit_s,
            _make_progress_callback(terminal, label),
            stop,
        )
        terminal.clear()
        if outcome.state is RunState.NOT_RUN:
            return kept or outcome
        folder.save(key, outcome, self._describe())
        if outcome.state is not RunState.DONE:
            logger.error("%s: %s", label, outcome)
            return outcome
        terminal.write_line(f"{label}: {outcome.run.cpu_s:.2f} s of processor time")
        return folder.load(key) or outcome  # the same figures as when it is kept from before

    def _make_request(self) -> RunRequest:
        level = logging.getLogger().getEffectiveLevel()
        return RunRequest(
            self.recording.folder,
            self.recording.camera_file,
            self.factory,
            level,
            self.recording.frame_selection,
            observer_factory=self.plan.observer_factory,
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
    def tell(word: RunPreparing | RunProgress) -> None:
        if isinstance(word, RunProgress):
            terminal.progress(f"{label}: frame", word.done, word.total)
        else:
            terminal.show(f"{label}: preparing, {word.stage}")

    return tell

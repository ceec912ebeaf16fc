"""Every method on every recording, one after another; what is kept already is not run again."""

import logging
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vo_service.runs.keeping import RunFolder
from vo_service.runs.key import run_key
from vo_service.runs.listening import NOBODY, ListenerRecipe
from vo_service.runs.messages import Job, Preparing, Progress
from vo_service.runs.recipe import Recipe
from vo_service.runs.run import Outcome, RunState
from vo_service.runs.running import run_in_child
from vo_service.runs.sequence import Recording
from vo_service.runs.versions import versions
from vo_service.terminal import Terminal

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Plan:
    """What to run.

    recipes  by the method's name
    folder   where runs are kept, one folder a recording and in it one a method
    limit_s  for each run
    again    also what is kept
    listener who hears what the methods say, in each run
    """

    recordings: Sequence[Recording]
    recipes: Mapping[str, Recipe]
    folder: Path
    limit_s: float
    again: bool = False
    listener: ListenerRecipe = NOBODY


@dataclass(frozen=True)
class Entry:
    """One run, as it came out.

    has_loops  they were asked for
    """

    recording: Recording
    method: str
    outcome: Outcome
    has_loops: bool = False


def run_all(plan: Plan, terminal: Terminal, stop: threading.Event) -> Iterator[Entry]:
    """Run what is not kept, until `stop` is set; the rest is then kept from before or not run.

    Only runs that came to their end are kept for good: one that failed is tried again the next
    time. Raises UserFacingError if results cannot be kept or no process can be started.
    """
    total = len(plan.recordings) * len(plan.recipes)
    number = 0
    for recording in plan.recordings:
        for method, recipe in plan.recipes.items():
            number += 1
            label = f"{recording.name}, {method} (run {number} of {total})"
            run = _Run(plan, recording, method, recipe)
            outcome = run.outcome(label, terminal, stop)
            yield Entry(recording, method, outcome, bool(plan.listener.settings))


@dataclass(frozen=True)
class _Run:
    """One run: kept from before, or made."""

    plan: Plan
    recording: Recording
    method: str
    recipe: Recipe

    def outcome(self, label: str, terminal: Terminal, stop: threading.Event) -> Outcome:
        folder = RunFolder(self.plan.folder / self.recording.name / self.method)
        key = run_key(self.recording, self.recipe, versions(), self.plan.listener)
        kept = folder.load(key)
        if kept is not None and kept.state is RunState.DONE and not self.plan.again:
            terminal.say(f"{label}: kept from before")
            return kept
        if stop.is_set():
            return kept or Outcome(RunState.NOT_RUN, trouble="stopped before it began")
        terminal.show(f"{label}: starting")
        outcome = run_in_child(self._job(), self.plan.limit_s, _teller(terminal, label), stop)
        terminal.clear()
        if outcome.state is RunState.NOT_RUN:
            return kept or outcome
        folder.save(key, outcome, self._about())
        if outcome.state is not RunState.DONE:
            logger.error("%s: %s", label, outcome)
            return outcome
        terminal.say(f"{label}: {outcome.run.cpu_s:.2f} s of processor time")
        return folder.load(key) or outcome  # the same figures as when it is kept from before

    def _job(self) -> Job:
        level = logging.getLogger().getEffectiveLevel()
        return Job(
            self.recording.folder,
            self.recording.camera_file,
            self.recipe,
            level,
            self.recording.excerpt,
            listener=self.plan.listener,
        )

    def _about(self) -> dict[str, object]:
        return {
            "recording": self.recording.name,
            "folder": str(self.recording.folder.resolve()),
            "every": self.recording.excerpt.every,
            "first": self.recording.excerpt.first,
            "method": self.method,
            "settings": {**self.recipe.settings, **self.plan.listener.settings},
            "versions": versions(),
        }


def _teller(terminal: Terminal, label: str) -> Callable[[Preparing | Progress], None]:
    def tell(word: Preparing | Progress) -> None:
        if isinstance(word, Progress):
            terminal.progress(f"{label}: frame", word.done, word.total)
        else:
            terminal.show(f"{label}: preparing, {word.stage}")

    return tell

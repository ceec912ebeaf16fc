"""How good a run was: every figure of it that its recording lets one tell."""

import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

from drivers.errors import InputError
from vo_service.evaluation import Evaluation, evaluate
from vo_service.evaluation.association import MatchedPoses, associate
from vo_service.evaluation.gaps import Crossing, cross, error_across, within_gaps
from vo_service.evaluation.gross_errors import gross_errors, tracked_steps
from vo_service.evaluation.metrics import RelativeErrors, consecutive_pairs, relative_errors, rms
from vo_service.runs.campaign import Entry
from vo_service.runs.keeping import run_as_json
from vo_service.runs.run import Outcome, Run, RunState
from vo_service.runs.sequence import Recording
from vo_service.summary import WithLoops, evaluated

EVALUATED = tuple(Evaluation.__dataclass_fields__)
# Keys that are there where loops were asked for.
LOOPS_MS = "loops_ms_per_frame"
LOOPS = (*WithLoops(0, 0, None).as_json(), LOOPS_MS)


@dataclass(frozen=True)
class Judgement:
    """A run and its figures. None: cannot be told.

    no_evaluation  why there is none, "" where there is one
    coverage       frames with a pose, of those that the recording lists (and that have ground
                   truth, where there is any)
    crossings      one a pause of the recording; none where there is no run
    jumps          error of the motion across each pause, (1,) each
    rpe_frame_without_gaps_m  RPE of one frame without the steps across the pauses
    steps          from a pose to the next one in the same epoch, where both have ground truth
    gross_errors   of these, how many are off by more than 5 cm or 3 degrees
    corrected      of the trajectory as loops have corrected it, where they were asked for
    """

    entry: Entry
    evaluation: Evaluation | None = None
    matched: MatchedPoses | None = None
    no_evaluation: str = ""
    coverage: float | None = None
    crossings: tuple[Crossing, ...] = ()
    jumps: tuple[RelativeErrors | None, ...] = ()
    rpe_frame_without_gaps_m: float | None = None
    steps: int | None = None
    gross_errors: int | None = None
    corrected: Evaluation | None = None

    @property
    def outcome(self) -> Outcome:
        """How the run ended."""
        return self.entry.outcome

    @property
    def is_done(self) -> bool:
        """Whether the run came to its end."""
        return self.outcome.state is RunState.DONE

    @property
    def why_lost(self) -> list[tuple[str, int]]:
        """Why frames had no pose, and how many; numbers in the reasons are left out."""
        reasons = (re.sub(r"\d+(\.\d+)?", "#", text) for text in self.outcome.run.frames.reasons)
        return Counter(filter(None, reasons)).most_common()

    def as_json(self) -> dict[str, Any]:
        """One flat object; null for what could not be computed."""
        done = self.is_done
        run = run_as_json(self.outcome.run)
        evaluated = self.evaluation.as_json() if self.evaluation else dict.fromkeys(EVALUATED)
        return {
            "state": self.outcome.state,
            "trouble": self.outcome.trouble,
            "no_evaluation": self.no_evaluation,
            **(run if done else dict.fromkeys(run)),
            **evaluated,
            "coverage": self.coverage,
            "rpe_frame_without_gaps_m": self.rpe_frame_without_gaps_m,
            "steps": self.steps,
            "gross_errors": self.gross_errors,
            "gaps": [
                {"across": str(crossing), **_jump_as_json(jump)}
                for crossing, jump in zip(self.crossings, self.jumps, strict=True)
            ],
            "why_lost": dict(self.why_lost),
            **self._loops_as_json(),
        }

    def _loops_as_json(self) -> dict[str, Any]:
        if not self.entry.has_loops:
            return {}
        run = self.outcome.run.with_loops
        if run is None:
            return dict.fromkeys(LOOPS)
        with_loops = WithLoops(run.places, run.loops, self.corrected)
        return {**with_loops.as_json(), LOOPS_MS: run.cpu_ms}


def judge(entry: Entry) -> Judgement:
    """Everything that can be told of a run."""
    run, recording = entry.outcome.run, entry.recording
    if entry.outcome.state is not RunState.DONE:
        return Judgement(entry, no_evaluation="there is no result")
    frames = run.frames
    crossings = tuple(
        cross(gap, frames.stamps_s, frames.is_good, frames.epochs) for gap in recording.gaps
    )
    without_truth = Judgement(
        entry,
        coverage=len(run.trajectory) / len(recording.frames_s),
        crossings=crossings,
        jumps=(None,) * len(crossings),
    )
    return _evaluated(without_truth, run, recording)


def _evaluated(judgement: Judgement, run: Run, recording: Recording) -> Judgement:
    """With the figures that need the truth, where there is one; else with why not."""
    if recording.truth is None:
        return replace(judgement, no_evaluation="there is no groundtruth.txt")
    if not len(run.trajectory):
        return replace(judgement, no_evaluation="no frame has a pose")
    try:
        evaluation = evaluate(run.trajectory, recording.truth, recording.frames_s)
    except InputError as error:
        return replace(judgement, no_evaluation=str(error))
    matched = associate(run.trajectory, recording.truth)
    pairs = consecutive_pairs(matched)
    steps_m = relative_errors(matched, pairs).translation_m
    good = run.frames.is_good
    steps = tracked_steps(matched, run.trajectory.stamps_s, run.frames.epochs[good])
    return replace(
        judgement,
        evaluation=evaluation,
        matched=matched,
        coverage=evaluation.coverage,
        jumps=tuple(error_across(matched, gap) for gap in recording.gaps),
        steps=len(steps),
        gross_errors=gross_errors(matched, steps),
        corrected=_corrected(run, recording),
        rpe_frame_without_gaps_m=rms(steps_m[~within_gaps(matched, pairs, recording.gaps)]),
    )


def _corrected(run: Run, recording: Recording) -> Evaluation | None:
    if run.with_loops is None:
        return None
    return evaluated(run.with_loops.trajectory, recording.truth, recording.frames_s)


def _jump_as_json(jump: RelativeErrors | None) -> dict[str, float | None]:
    if jump is None:
        return {"error_m": None, "error_deg": None}
    return {"error_m": float(jump.translation_m[0]), "error_deg": float(jump.rotation_deg[0])}

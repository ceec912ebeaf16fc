"""Evaluation of the runs: all metrics that each recording allows."""

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from drivers.core import InputError
from vo_service.tools.compare.recordings import BenchmarkRecording
from vo_service.tools.compare.run_cache import run_as_json
from vo_service.tools.compare.run_outcome import RunOutcome, RunState
from vo_service.tools.evaluation.evaluation import EVALUATION_KEYS, Evaluation, evaluate
from vo_service.tools.evaluation.gaps import GapOutcome, classify_gap, gap_error, spans_gap
from vo_service.tools.evaluation.metrics import (
    MatchedPoses,
    RelativeErrors,
    associate,
    consecutive_pairs,
    count_gross_errors,
    relative_errors,
    rms,
    tracked_steps,
)
from vo_service.tools.evaluation.run_summary import evaluate_if_possible

# A method with a lower coverage may have poses of the easy frames only.
MIN_RANKED_COVERAGE = 0.9


@dataclass(frozen=True)
class RunEvaluation:
    """A run and its metrics; None means that a metric is not known.

    Attributes:
        matched: Poses with their ground truth.
        no_evaluation_reason: Why `evaluation` is None; "" otherwise.
        coverage: Fraction of the recording's frames with a pose; with ground truth, only frames
            that have it count.
        gap_outcomes: One per gap of the recording; empty without a result.
        gap_errors: Error of the motion across each gap, (1,) each.
        rpe_frame_without_gaps_m: RPE of one frame without the steps across gaps.
        steps: Number of steps between successive poses of an epoch, both with ground truth.
        gross_errors: Number of these steps with an error of more than 5 cm or 3 degrees.
        optimized_evaluation: Metrics of the trajectory after loop closure, if it was enabled.
    """

    outcome: RunOutcome
    evaluation: Evaluation | None = None
    matched: MatchedPoses | None = None
    no_evaluation_reason: str = ""
    coverage: float | None = None
    gap_outcomes: tuple[GapOutcome, ...] = ()
    gap_errors: tuple[RelativeErrors | None, ...] = ()
    rpe_frame_without_gaps_m: float | None = None
    steps: int | None = None
    gross_errors: int | None = None
    optimized_evaluation: Evaluation | None = None

    @property
    def is_done(self) -> bool:
        """Whether the run is complete."""
        return self.outcome.state is RunState.DONE

    @property
    def lost_reasons(self) -> list[tuple[str, int]]:
        """Reasons for lost frames and their counts; numbers in the reasons are replaced by #."""
        frames = self.outcome.run.frames
        reasons = frames["reason"][~frames["has_pose"]]
        return Counter(re.sub(r"\d+(\.\d+)?", "#", reason) for reason in reasons).most_common()

    def as_json(self) -> dict[str, Any]:
        """Return state, run and evaluation as one flat object; null for unknown metrics."""
        run = run_as_json(self.outcome.run)
        metrics = self.evaluation.as_json() if self.evaluation else dict.fromkeys(EVALUATION_KEYS)
        return {
            "state": self.outcome.state,
            "error": self.outcome.error,
            "no_evaluation": self.no_evaluation_reason,
            **(run if self.is_done else dict.fromkeys(run)),
            **metrics,
            "rpe_frame_without_gaps_m": self.rpe_frame_without_gaps_m,
            "gaps": [
                {
                    "across": str(outcome),
                    "error_m": error and float(error.translation_m[0]),
                    "error_deg": error and float(error.rotation_deg[0]),
                }
                for outcome, error in zip(self.gap_outcomes, self.gap_errors, strict=True)
            ],
            "why_lost": dict(self.lost_reasons),
        }


def evaluate_run(recording: BenchmarkRecording, outcome: RunOutcome) -> RunEvaluation:
    """Evaluate a run with all metrics that are possible."""
    if outcome.state is not RunState.DONE:
        return RunEvaluation(outcome, no_evaluation_reason="the run has no result")
    frames = outcome.run.frames
    gap_outcomes = tuple(
        classify_gap(gap, frames["stamp_s"], frames["has_pose"], frames["epoch"])
        for gap in recording.gaps
    )
    without_truth = RunEvaluation(
        outcome,
        coverage=len(outcome.run.trajectory) / len(recording.frame_stamps_s),
        gap_outcomes=gap_outcomes,
        gap_errors=(None,) * len(gap_outcomes),
    )
    return _with_ground_truth(without_truth, recording)


def _with_ground_truth(
    run_evaluation: RunEvaluation, recording: BenchmarkRecording
) -> RunEvaluation:
    """Add the metrics that need the truth, or the reason why there are none."""
    run = run_evaluation.outcome.run
    if recording.truth is None:
        return replace(run_evaluation, no_evaluation_reason="there is no groundtruth.txt")
    if not len(run.trajectory):
        return replace(run_evaluation, no_evaluation_reason="no frame has a pose")
    try:
        evaluation = evaluate(run.trajectory, recording.truth, recording.frame_stamps_s)
    except InputError as error:
        return replace(run_evaluation, no_evaluation_reason=str(error))
    matched = associate(run.trajectory, recording.truth)
    pairs = consecutive_pairs(matched)
    steps_m = relative_errors(matched, pairs).translation_m
    epochs = run.frames["epoch"][run.frames["has_pose"]]
    steps = tracked_steps(matched, run.trajectory.stamps_s, epochs)
    optimized = None
    if run.loop_closure is not None:
        optimized = evaluate_if_possible(
            run.loop_closure.trajectory, recording.truth, recording.frame_stamps_s
        )
    return replace(
        run_evaluation,
        evaluation=evaluation,
        matched=matched,
        coverage=evaluation.coverage,
        gap_errors=tuple(gap_error(matched, gap) for gap in recording.gaps),
        steps=len(steps),
        gross_errors=count_gross_errors(matched, steps),
        optimized_evaluation=optimized,
        rpe_frame_without_gaps_m=rms(steps_m[~spans_gap(matched, pairs, recording.gaps)]),
    )


@dataclass(frozen=True)
class SequenceResults:
    """One recording and the evaluations of all methods on it.

    Attributes:
        reference_method: Baseline for relative figures; None without.
        has_loop_closure: Whether loop closure was enabled.
    """

    recording: BenchmarkRecording
    evaluations: Mapping[str, RunEvaluation]
    reference_method: str | None = None
    has_loop_closure: bool = False

    @property
    def reference(self) -> RunEvaluation | None:
        """Evaluation of the baseline for relative figures."""
        return None if self.reference_method is None else self.evaluations[self.reference_method]

    def best_method(self, value: Callable[[RunEvaluation], float | None]) -> str | None:
        """Return the method with the smallest value, or None if fewer than two have one.

        Methods with low coverage do not count.
        """
        values = {
            method: value(evaluation)
            for method, evaluation in self.evaluations.items()
            if evaluation.coverage is not None and evaluation.coverage >= MIN_RANKED_COVERAGE
        }
        known = {method: number for method, number in values.items() if number is not None}
        return min(known, key=lambda method: known[method]) if len(known) > 1 else None


def evaluate_runs(
    recording: BenchmarkRecording,
    outcomes: Mapping[str, RunOutcome],
    reference_method: str | None = None,
    has_loop_closure: bool = False,
) -> SequenceResults:
    """Evaluate the runs of all methods on one recording."""
    evaluations = {method: evaluate_run(recording, outcomes[method]) for method in outcomes}
    return SequenceResults(recording, evaluations, reference_method, has_loop_closure)

"""Results of a comparison by recording."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from vo_service.tools.benchmark.batch import BatchResult
from vo_service.tools.benchmark.evaluate_run import RunEvaluation, evaluate_run
from vo_service.tools.benchmark.recordings import BenchmarkRecording

# A method with a lower coverage may have poses of the easy frames only.
MIN_RANKED_COVERAGE = 0.9


@dataclass(frozen=True)
class SequenceResults:
    """One recording and the evaluations of all methods on it."""

    recording: BenchmarkRecording
    evaluations: Mapping[str, RunEvaluation]

    @property
    def has_loop_closure(self) -> bool:
        """Whether loop closure was enabled."""
        return any(
            evaluation.batch_result.has_loop_closure for evaluation in self.evaluations.values()
        )

    def as_json(self) -> dict[str, Any]:
        """Return the facts of the recording and the metrics of each method."""
        recording = self.recording
        return {
            "name": recording.name,
            "folder": str(recording.folder.resolve()),
            "frames": len(recording.frame_stamps_s),
            "duration_s": recording.duration_s,
            "path_m": recording.path_m,
            "has_ground_truth": recording.truth is not None,
            "gaps": [
                {"begin_s": gap.begin_s, "end_s": gap.end_s, "length_s": gap.length_s}
                for gap in recording.gaps
            ],
            "methods": {
                method: evaluation.as_json() for method, evaluation in self.evaluations.items()
            },
        }

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


def collect_results(batch_results: Iterable[BatchResult]) -> list[SequenceResults]:
    """Evaluate all runs, in their order."""
    recordings: dict[str, BenchmarkRecording] = {}
    evaluations: dict[str, dict[str, RunEvaluation]] = {}
    for result in batch_results:
        recordings[result.recording.name] = result.recording
        evaluations.setdefault(result.recording.name, {})[result.method] = evaluate_run(result)
    return [SequenceResults(recordings[name], evaluations[name]) for name in recordings]

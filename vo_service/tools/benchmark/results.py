"""All results, recording by recording."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from vo_service.tools.benchmark.batch import BatchResult
from vo_service.tools.benchmark.evaluate_run import RunEvaluation, evaluate_run
from vo_service.tools.benchmark.recordings import BenchmarkRecording

# A method that gives a pose to fewer frames than this has the easy ones alone.
MIN_RANKED_COVERAGE = 0.9


@dataclass(frozen=True)
class SequenceResults:
    """One recording, and how good each method was on it."""

    recording: BenchmarkRecording
    evaluations: Mapping[str, RunEvaluation]

    @property
    def has_loop_closure(self) -> bool:
        """Whether they were asked for."""
        return any(judged.batch_result.has_loop_closure for judged in self.evaluations.values())

    def as_json(self) -> dict[str, Any]:
        """What the recording is, and the figures of each method."""
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
            "methods": {method: judged.as_json() for method, judged in self.evaluations.items()},
        }

    def best_method(self, value: Callable[[RunEvaluation], float | None]) -> str | None:
        """The method of the smallest value; None where fewer than two have one.

        One that placed few of the frames is not the best of anything.
        """
        values = {
            method: value(judged)
            for method, judged in self.evaluations.items()
            if judged.coverage is not None and judged.coverage >= MIN_RANKED_COVERAGE
        }
        known = {method: found for method, found in values.items() if found is not None}
        return min(known, key=lambda method: known[method]) if len(known) > 1 else None


def collect_results(batch_results: Iterable[BatchResult]) -> list[SequenceResults]:
    """Judge all runs; in the order in which they come."""
    recordings: dict[str, BenchmarkRecording] = {}
    judged: dict[str, dict[str, RunEvaluation]] = {}
    for entry in batch_results:
        recordings[entry.recording.name] = entry.recording
        judged.setdefault(entry.recording.name, {})[entry.method] = evaluate_run(entry)
    return [SequenceResults(recordings[name], judged[name]) for name in recordings]

"""A figure of a run as a column of a table."""

from collections.abc import Callable
from dataclasses import dataclass

from vo_service.runs.judging import RunEvaluation
from vo_service.runs.run import CompletedRun, LoopClosureRun

MetricFunction = Callable[[RunEvaluation], float | None]


@dataclass(frozen=True)
class MetricColumn:
    """Its name in files, its heading for people, how it is got, and how it is shown.

    digits  after the point; `factor` is for the eyes alone
    """

    key: str
    heading: str
    value: MetricFunction
    digits: int
    display_factor: float = 1.0


def from_evaluation(key: str) -> MetricFunction:
    """A field of the `Evaluation`, where there is one."""
    return lambda judged: getattr(judged.evaluation, key) if judged.evaluation else None


def from_optimized_evaluation(key: str) -> MetricFunction:
    """A field of the `Evaluation` of the trajectory that loops have corrected."""
    return lambda judged: (
        getattr(judged.optimized_evaluation, key) if judged.optimized_evaluation else None
    )


def from_loop_closure(value: Callable[[LoopClosureRun], float]) -> MetricFunction:
    """A figure of the loops of a run, where they were asked for."""

    def judge(judged: RunEvaluation) -> float | None:
        with_loops = judged.outcome.run.loop_closure
        return None if with_loops is None else value(with_loops)

    return judge


def from_run(value: Callable[[CompletedRun], float]) -> MetricFunction:
    """A figure of a run that came to its end."""
    return lambda judged: value(judged.outcome.run) if judged.is_done else None

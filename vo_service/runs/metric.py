"""A figure of a run as a column of a table."""

from collections.abc import Callable
from dataclasses import dataclass

from vo_service.runs.judging import Judgement
from vo_service.runs.run import LoopsRun, Run

Judged = Callable[[Judgement], float | None]


@dataclass(frozen=True)
class Metric:
    """Its name in files, its heading for people, how it is got, and how it is shown.

    digits  after the point; `factor` is for the eyes alone
    """

    key: str
    heading: str
    value: Judged
    digits: int
    factor: float = 1.0


def evaluated(key: str) -> Judged:
    """A field of the `Evaluation`, where there is one."""
    return lambda judged: getattr(judged.evaluation, key) if judged.evaluation else None


def corrected(key: str) -> Judged:
    """A field of the `Evaluation` of the trajectory that loops have corrected."""
    return lambda judged: getattr(judged.corrected, key) if judged.corrected else None


def of_loops(value: Callable[[LoopsRun], float]) -> Judged:
    """A figure of the loops of a run, where they were asked for."""

    def judge(judged: Judgement) -> float | None:
        with_loops = judged.outcome.run.with_loops
        return None if with_loops is None else value(with_loops)

    return judge


def of_run(value: Callable[[Run], float]) -> Judged:
    """A figure of a run that came to its end."""
    return lambda judged: value(judged.outcome.run) if judged.is_done else None

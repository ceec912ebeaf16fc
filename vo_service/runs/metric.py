"""A figure of a run as a column of a table."""

from collections.abc import Callable
from dataclasses import dataclass

from vo_service.runs.judging import Judgement
from vo_service.runs.run import Run

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


def of_run(value: Callable[[Run], float]) -> Judged:
    """A figure of a run that came to its end."""
    return lambda judged: value(judged.outcome.run) if judged.is_done else None

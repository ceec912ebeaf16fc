"""A table, for people as text and for scripts as CSV."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from vo_service.tools.benchmark.evaluate_run import RunEvaluation
from vo_service.tools.benchmark.run import CompletedRun, LoopClosureRun


@dataclass(frozen=True)
class TableCell:
    """A value as scripts get it (None: cannot be told), and as people do."""

    value: float | str | None
    text: str
    is_best: bool = False


@dataclass(frozen=True)
class Table:
    """Named rows and columns.

    name   of its file
    title  for people
    keys   of the columns, for scripts; head for people
    """

    name: str
    title: str
    keys: Sequence[str]
    headings: Sequence[str]
    rows: Sequence[Sequence[TableCell]]

    def as_csv(self) -> str:
        """Comma-separated, values in full; empty for what cannot be told."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.keys)
        for row in self.rows:
            writer.writerow("" if cell.value is None else cell.value for cell in row)
        return text.getvalue()

    def as_text(self) -> str:
        """Aligned columns under the title; the best of a row has a star."""
        rows = [[f"{cell.text}{'*' if cell.is_best else ' '}" for cell in row] for row in self.rows]
        head = [f"{text} " for text in self.headings]
        widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
        lines = [_format_line(row, widths) for row in [head, *rows]]
        return "\n".join([self.title, *lines])


def number_cell(
    value: float | None, digits: int, display_factor: float = 1.0, is_best: bool = False
) -> TableCell:
    """A number with so many digits after the point; `factor` is for the eyes alone."""
    if value is None:
        return TableCell(None, "-")
    return TableCell(value, f"{display_factor * value:.{digits}f}", is_best)


def text_cell(value: str, text: str | None = None) -> TableCell:
    """A word, and how people call it."""
    return TableCell(value, value if text is None else text)


def _format_line(texts: Sequence[str], widths: Sequence[int]) -> str:
    first, *others = zip(texts, widths, strict=True)
    left = f"{first[0]:<{first[1]}}"
    return "  ".join([left, *(f"{text:>{width}}" for text, width in others)]).rstrip()


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

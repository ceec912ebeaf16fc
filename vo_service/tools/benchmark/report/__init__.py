"""Tables, as text for people and as CSV for scripts."""

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TextIO

from vo_service.terminal import make_console
from vo_service.tools.benchmark import CompletedRun, LoopClosureRun
from vo_service.tools.benchmark.results import RunEvaluation

if TYPE_CHECKING:
    from rich.text import Text


# A table that is wider than the terminal is not cut.
MAX_WIDTH = 1000


@dataclass(frozen=True)
class TableCell:
    """Cell with a value for scripts (None if not known) and a text for people."""

    value: float | str | None
    text: str
    is_best: bool = False


@dataclass(frozen=True)
class Table:
    """Table with named columns.

    Attributes:
        name: Name of its file.
        title: Title for people.
        keys: Column names for scripts.
        headings: Column headings for people.
        rows: Cells by row.
    """

    name: str
    title: str
    keys: Sequence[str]
    headings: Sequence[str]
    rows: Sequence[Sequence[TableCell]]

    def as_csv(self) -> str:
        """Return comma-separated values with full precision; empty if not known."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.keys)
        for row in self.rows:
            writer.writerow("" if cell.value is None else cell.value for cell in row)
        return text.getvalue()

    def as_text(self) -> str:
        """Return aligned columns below the title; the best cell of a row has a star."""
        text = io.StringIO()
        self.write(text)
        return "\n".join(line.rstrip() for line in text.getvalue().splitlines())

    def write(self, stream: TextIO) -> None:
        """Write the same to a stream; on a terminal, headings and best cells are bold."""
        from rich import table  # slow to import

        columns = [
            table.Column(f"{heading} ", justify="right" if number else "left", no_wrap=True)
            for number, heading in enumerate(self.headings)
        ]
        grid = table.Table(*columns, box=None, pad_edge=False, header_style="bold")
        for row in self.rows:
            grid.add_row(*(_format_cell(cell) for cell in row))
        console = make_console(stream, MAX_WIDTH)
        console.print(self.title, style="bold")
        console.print(grid)


def _format_cell(cell: TableCell) -> "Text":
    from rich.text import Text

    return Text(f"{cell.text}*", style="bold green") if cell.is_best else Text(f"{cell.text} ")


def number_cell(
    value: float | None, digits: int, display_factor: float = 1.0, is_best: bool = False
) -> TableCell:
    """Make a cell of a number; digits and factor apply to the displayed text only.

    Args:
        value: The number; None if not known.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed number.
        is_best: Whether it is the best of its row.
    """
    if value is None:
        return TableCell(None, "-")
    return TableCell(value, f"{display_factor * value:.{digits}f}", is_best)


def text_cell(value: str, text: str | None = None) -> TableCell:
    """Make a cell of a text, with an optional other text for people."""
    return TableCell(value, value if text is None else text)


MetricFunction = Callable[[RunEvaluation], float | None]


@dataclass(frozen=True)
class MetricColumn:
    """Column of a metric.

    Attributes:
        key: Name for scripts.
        heading: Heading for people.
        value: Function that returns the metric of a run.
        digits: Displayed digits after the decimal point.
        display_factor: Factor of the displayed value.
    """

    key: str
    heading: str
    value: MetricFunction
    digits: int
    display_factor: float = 1.0


def from_evaluation(key: str) -> MetricFunction:
    """Return a function for a field of the `Evaluation`, None without one."""
    return lambda evaluation: getattr(evaluation.evaluation, key) if evaluation.evaluation else None


def from_optimized_evaluation(key: str) -> MetricFunction:
    """Return a function for a field of the optimized trajectory's `Evaluation`."""
    return lambda evaluation: (
        getattr(evaluation.optimized_evaluation, key) if evaluation.optimized_evaluation else None
    )


def from_loop_closure(value: Callable[[LoopClosureRun], float]) -> MetricFunction:
    """Return a function for a value of a run's loop closure, None without it."""

    def loop_closure_value(evaluation: RunEvaluation) -> float | None:
        run = evaluation.outcome.run.loop_closure
        return None if run is None else value(run)

    return loop_closure_value


def from_run(value: Callable[[CompletedRun], float]) -> MetricFunction:
    """Return a function for a value of a complete run, None for others."""
    return lambda evaluation: value(evaluation.outcome.run) if evaluation.is_done else None

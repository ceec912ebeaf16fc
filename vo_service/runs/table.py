"""A table, for people as text and for scripts as CSV."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass


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

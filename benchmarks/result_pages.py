"""The pages of docs/results: their data, and the tables and plots that are written from them."""

import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from textwrap import indent
from xml.sax.saxutils import escape

import numpy as np

from benchmarks.console_tables import Cell, decimals_of
from drivers.core.files import atomic_write

PAGES = Path(__file__).resolve().parents[1] / "docs" / "results"
BLOCK = re.compile(r"(?ms)^<!-- result: (?P<name>[\w-]+) -->\n.*?^<!-- end -->")
# Of a plot, pixels: a line, the space of the labels, of the bars, and of the values.
LINE, LABELS, BARS, VALUES = 18, 300, 340, 110
LOGARITHMIC_FROM = 50.0


@dataclass(frozen=True)
class ResultData:
    """The answer to one question.

    Attributes:
        name: Of its block in the page, and of its plot.
        command: What was run; several in lines.
        by_hand: Whether `python -m benchmarks results` leaves the command out.
        date, commit, machine: Of the run.
        columns, rows: The table.
        shown: The columns on the page; all if empty.
        plot: The column that is drawn; "" for no plot.
    """

    name: str
    command: str
    by_hand: bool
    date: str
    commit: str
    machine: str
    columns: list[str]
    rows: list[list[Cell]]
    shown: list[str]
    plot: str

    def table(self) -> str:
        """The table in Markdown."""
        shown = [i for i, name in enumerate(self.columns) if not self.shown or name in self.shown]
        decimals = [decimals_of(column) for column in zip(*self.rows, strict=True)]
        lines = [[self.columns[i] for i in shown], ["---"] * len(shown)]
        lines += [[_text(row[i], decimals[i]) for i in shown] for row in self.rows]
        return "\n".join(f"| {' | '.join(line)} |".replace("|  |", "| |") for line in lines)

    def block(self) -> str:
        """The block of the page: command, date, commit, table, plot."""
        run = f"\n{indent(self.command, ' ' * 4)}\n\nMade {self.date} at {self.commit}.\n"
        plot = f"\n![{self.plot}](plots/{self.name}.svg)\n" if self.plot else ""
        run = run if self.command else ""
        return f"<!-- result: {self.name} -->\n{run}\n{self.table()}\n{plot}\n<!-- end -->"

    def draw(self) -> str:
        """The plot, in SVG: a bar for each row, from 0 to its figure or over its range."""
        column = self.columns.index(self.plot)
        decimals = decimals_of([row[column] for row in self.rows])
        ranges = [_range(row[column]) for row in self.rows]
        scale = _Scale([high for _, high in ranges])
        labels = self._label_columns()
        title = escape(self.plot + ", logarithmic" * scale.is_logarithmic)
        marks = [f'<text x="{LABELS}" y="14" font-weight="bold">{title}</text>']
        for number, (row, (low, high)) in enumerate(zip(self.rows, ranges, strict=True)):
            y = LINE * (number + 1)
            label = escape(", ".join(str(row[i]) for i in labels if row[i]).replace("`", ""))
            begin, end = LABELS + scale(low), LABELS + scale(high)
            width, text = max(end - begin, 1), _text(row[column], decimals)
            marks += [
                f'<text x="{LABELS - 8}" y="{y + 14}" text-anchor="end">{label}</text>',
                f'<rect x="{begin}" y="{y + 4}" width="{width}" height="11"/>',
                f'<text x="{end + 5}" y="{y + 14}">{text}</text>',
            ]
        return "\n".join(
            [
                '<svg xmlns="http://www.w3.org/2000/svg" '
                f'width="{LABELS + BARS + VALUES}" height="{LINE * (len(self.rows) + 1) + 8}" '
                'font-family="sans-serif" font-size="12" fill="#333">',
                "<style>rect{fill:#4477aa}svg{background:#fff}</style>",
                *marks,
                "</svg>\n",
            ]
        )

    def _label_columns(self) -> list[int]:
        """The leading columns of texts."""
        names = [i for i in range(len(self.columns)) if all(_is_label(row[i]) for row in self.rows)]
        return [i for number, i in enumerate(names) if i == number] or [0]


class _Scale:
    """Pixels of a figure; logarithmic where the figures differ much."""

    def __init__(self, figures: Sequence[float]) -> None:
        positive = [figure for figure in figures if figure > 0] or [1.0]
        self._low, self._high = min(positive) / 2, max(positive)
        self.is_logarithmic = max(positive) / min(positive) > LOGARITHMIC_FROM

    def __call__(self, figure: float) -> int:
        if not self.is_logarithmic:
            return round(BARS * figure / self._high)
        ratio = np.log(max(figure, self._low) / self._low) / np.log(self._high / self._low)
        return round(BARS * float(ratio))


def read_results(file: Path) -> list[ResultData]:
    """Return the results of a page."""
    return [ResultData(**result) for result in json.loads(file.read_text())]


def write_results(file: Path, results: Sequence[ResultData]) -> None:
    """Write the results of a page, with a line for each row of a table."""
    text = json.dumps([asdict(result) for result in results], indent=1, ensure_ascii=False)
    lists = re.compile(r"\[\s+([^\[\]]*?)\s+\](?=,?\n)")
    text = lists.sub(lambda match: "[" + re.sub(r",\n\s+", ", ", match[1]) + "]", text)
    atomic_write(file, f"{text}\n".encode())


def write_page(file: Path) -> None:
    """Write the blocks and the plots of the page beside a file of data."""
    results = {result.name: result for result in read_results(file)}
    page = file.with_suffix(".md")
    atomic_write(page, render_page(page.read_text(), results).encode())
    for result in results.values():
        if result.plot:
            plot = file.parent / "plots" / f"{result.name}.svg"
            plot.parent.mkdir(exist_ok=True)
            atomic_write(plot, result.draw().encode())


def render_page(text: str, results: dict[str, ResultData]) -> str:
    """Return a page with the blocks of its results."""
    return BLOCK.sub(lambda match: results[match["name"]].block(), text)


def _text(cell: Cell, decimals: int) -> str:
    if cell is None:
        return "-"
    return f"{cell:.{decimals}f}" if isinstance(cell, float) else str(cell)


def _is_label(cell: Cell) -> bool:
    return cell is None or (isinstance(cell, str) and not re.match(r"-?[\d.]+( to | %|, |$)", cell))


def _range(cell: Cell) -> tuple[float, float]:
    """The range of a bar: from 0 to a number, or over the numbers of a text such as "3 to 5"."""
    if not isinstance(cell, str):
        return 0.0, float(cell or 0.0)
    figures = [float(figure) for figure in re.findall(r"-?\d+(?:\.\d+)?", cell)] or [0.0]
    return (min(figures), max(figures)) if len(figures) > 1 else (0.0, figures[0])

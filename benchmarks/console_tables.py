"""Tables that commands print on a terminal, read back as columns and rows."""

import re
from collections.abc import Sequence
from contextlib import suppress

Cell = str | float | None


def read_tables(output: str) -> tuple[list[str], list[list[Cell]]]:
    """Return the columns and rows of all tables of an output, in one table.

    The cells of a line are apart by two spaces or more. A line of one cell above a table names its
    section, which becomes the first column; the columns of a second table of the same section are
    added to the rows of the first. Ratios in parentheses and lines with fewer cells than there are
    headings are left out.
    """
    section, headings, columns = "", None, list[str]()
    rows: dict[tuple[str, str], dict[str, Cell]] = {}
    for line in output.splitlines():
        cells = re.split(r"\s{2,}", line.strip())
        if not line.strip():
            headings = None
        elif len(cells) == 1:
            section, headings = re.split(r"[,:]", cells[0])[0], None
        elif headings is None:
            headings = _distinct(["", *cells] if line[0] == " " else cells)
            columns += [heading for heading in headings[1:] if heading not in columns]
        elif len(cells) >= len(headings):
            row = rows.setdefault((section, cells[0]), {})
            values = (read_cell(re.sub(r" \([\d.]+\)$", "", cell)) for cell in cells[1:])
            row.update(zip(headings[1:], values, strict=False))
    table = [[*names, *(row.get(name) for name in columns)] for names, row in rows.items()]
    if len({section for section, _ in rows}) < 2:
        return ["", *columns], [row[1:] for row in table]
    return ["recording", "", *columns], table


def _distinct(headings: Sequence[str]) -> list[str]:
    """Headings of statistics with the quantity of the mean before them."""
    quantity, names = "", []
    for heading in headings:
        if heading not in ("median", "p95", "p99"):
            quantity = heading.removesuffix("mean") if heading.endswith(" mean") else ""
        names.append(heading if heading.startswith(quantity) else quantity + heading)
    return names


def read_cell(text: str) -> Cell:
    """Return the number of a cell; None for "-"; else the text."""
    for kind in (int, float):
        with suppress(ValueError):
            return kind(text)
    return None if text in ("-", "") else text


def decimals_of(cells: Sequence[Cell]) -> int:
    """Return the largest number of decimals in a column."""
    return max((len(f"{c}".partition(".")[2]) for c in cells if isinstance(c, float)), default=0)

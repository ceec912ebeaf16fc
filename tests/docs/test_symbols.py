"""The names beside the symbols of the methods are those of the code."""

import re
from collections.abc import Iterable

from tests.docs.blocks import ROOT

DESIGN = ROOT / "docs" / "design"
ODOMETRY = ROOT / "vo_service" / "odometry"


def rows_of(text: str) -> list[list[str]]:
    """The cells of the rows of all tables."""
    rows = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in row] for row in rows]


def names_in(cell: str) -> set[str]:
    """The names of the code in a cell."""
    return set(re.findall(r"[A-Za-z_]\w*", " ".join(re.findall(r"`([^`]+)`", cell))))


def missing_names(names: Iterable[str], source: str) -> list[str]:
    """The names that a source does not have."""
    return [name for name in sorted(names) if not re.search(rf"\b{name}\b", source)]


def test_names_of_the_direct_method_exist() -> None:
    symbols = (DESIGN / "direct.md").read_text().partition("### Symbols\n")[2].partition("\n## ")[0]
    names = set().union(*(names_in(row[2]) for row in rows_of(symbols)))
    source = "".join(file.read_text() for file in (ODOMETRY / "direct").glob("*.py"))
    assert len(names) > 30
    assert missing_names(names, source) == []


def test_names_of_the_other_methods_exist_in_the_files_beside_them() -> None:
    rows = [row for row in rows_of((DESIGN / "symbols.md").read_text()) if "`" in row[-1]]
    assert len(rows) > 40
    missing = []
    for _, _, code, files in rows:
        paths = re.findall(r"`([\w/.]+)`", files)
        folders = {path: ROOT if path.startswith("drivers/") else ODOMETRY for path in paths}
        source = "".join((folder / path).read_text() for path, folder in folders.items())
        missing += missing_names(names_in(code), source)
    assert missing == []

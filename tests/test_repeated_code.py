"""No passage of the product stands in it twice."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
MAX_EQUAL_LINES = 8
Place = tuple[str, int]


def code_lines(file: Path) -> list[tuple[int, str]]:
    """Lines with their numbers: no imports, docstrings, comments, decorators or lone brackets."""
    text = file.read_text()
    left_out: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import | ast.ImportFrom) or (
            isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)  # a docstring
        ):
            left_out.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    return [
        (number, line)
        for number, line in lines
        if number not in left_out and line.strip("()[]{},:") and line[0] not in "#@"
    ]


def test_no_more_than_eight_equal_lines_stand_twice() -> None:
    places: dict[tuple[str, ...], list[Place]] = defaultdict(list)
    for package in ("drivers", "vo_service"):
        for file in sorted((ROOT / package).rglob("*.py")):
            lines = code_lines(file)
            for first in range(len(lines) - MAX_EQUAL_LINES):
                run = tuple(line for _, line in lines[first : first + MAX_EQUAL_LINES + 1])
                places[run].append((str(file.relative_to(ROOT)), lines[first][0]))
    repeated = [found for found in places.values() if len(found) > 1]
    assert not repeated, "give what these places share a name"

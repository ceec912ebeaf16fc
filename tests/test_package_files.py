"""An `__init__.py` has no content of its own: that is in files with its name."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAX_LINES = 40
FILES = [file for name in ("drivers", "vo_service") for file in (ROOT / name).rglob("__init__.py")]


@pytest.mark.parametrize("file", FILES, ids=lambda file: str(file.parent.relative_to(ROOT)))
def test_a_package_only_describes_itself_and_names_what_is_public(file: Path) -> None:
    text = file.read_text()
    assert text.count("\n") <= MAX_LINES
    statements = ast.parse(text).body
    assert ast.get_docstring(ast.parse(text))
    for statement in statements[1:]:
        names = ast.walk(statement) if isinstance(statement, ast.Assign) else ()
        assigned = {name.id for name in names if isinstance(name, ast.Name)}
        assert isinstance(statement, ast.ImportFrom) or "__all__" in assigned

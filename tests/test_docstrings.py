"""Public functions with several parameters describe each of them."""

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
MIN_PARAMETERS = 3
# Number of public functions that still lack an `Args:` section, by package. Lower a number when the
# package gets better; a package that is not listed has none.
MAX_GAPS = {
    "drivers/bag": 2,
    "drivers/core": 3,
    "drivers/freenect": 4,
    "drivers/kinect_usb": 2,
    "drivers/openni2": 4,
    "drivers/recording": 1,
    "drivers/subprocess_camera": 1,
    "drivers/synthetic": 4,
    "vo_service/cli": 1,
    "vo_service/outputs": 4,
    "vo_service/slam": 3,
    "vo_service/tools": 6,
}


def public_functions(node: ast.AST) -> Iterator[ast.FunctionDef]:
    """Yield the public functions and methods of a module, but not those inside functions."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef) and not child.name.startswith("_"):
            yield child
        elif isinstance(child, ast.ClassDef) and not child.name.startswith("_"):
            yield from public_functions(child)


def parameters(function: ast.FunctionDef) -> list[str]:
    arguments = function.args
    names = [each.arg for each in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    return [name for name in names if name not in ("self", "cls")]


def lacks_arguments(function: ast.FunctionDef) -> bool:
    return "Args:" not in (ast.get_docstring(function) or "")


def count_gaps(file: Path) -> int:
    return sum(
        len(parameters(function)) >= MIN_PARAMETERS and lacks_arguments(function)
        for function in public_functions(ast.parse(file.read_text()))
    )


def test_parameters_of_public_functions_are_described() -> None:
    gaps: Counter[str] = Counter()
    for package in ("drivers", "vo_service"):
        for file in (ROOT / package).rglob("*.py"):
            area = "/".join(file.relative_to(ROOT).parts[:2])
            gaps[area] += count_gaps(file)
    more = {area: count for area, count in gaps.items() if count > MAX_GAPS.get(area, 0)}
    assert not more, "describe shapes, units and frames under `Args:`"

"""No file and no package imports itself by way of others, lazy imports included."""

import ast
from collections.abc import Callable, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("drivers", "vo_service")


def module_name(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts).removesuffix(".__init__")


MODULES = {module_name(file): file for name in PACKAGES for file in (ROOT / name).rglob("*.py")}


@cache
def imported(file: Path) -> frozenset[str]:
    """Names of our modules that a file imports, wherever in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & MODULES.keys()
            names |= submodules or {node.module} & MODULES.keys()
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names} & MODULES.keys()
    return frozenset(names)


def whole(module: str) -> str:
    return module


def package(module: str) -> str:
    """The folder or file right below `drivers` or `vo_service`."""
    return ".".join(module.split(".")[:2])


def grouped(unit_of: Callable[[str], str]) -> Mapping[str, set[str]]:
    """Which units each unit imports."""
    units: dict[str, set[str]] = {}
    for module, file in MODULES.items():
        unit = unit_of(module)
        units.setdefault(unit, set()).update(unit_of(other) for other in imported(file))
    return {unit: others - {unit} for unit, others in units.items()}


@pytest.mark.parametrize("unit_of", [whole, package])
def test_there_are_no_import_cycles(unit_of: Callable[[str], str]) -> None:
    assert len(MODULES) > 100
    try:
        TopologicalSorter(grouped(unit_of)).prepare()
    except CycleError as circle:
        pytest.fail(f"a circle: {' -> '.join(circle.args[1])}")

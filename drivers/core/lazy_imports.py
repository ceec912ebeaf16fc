"""Public names of a package that are imported when they are first used (PEP 562)."""

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

_REEXPORT = re.compile(r"^from (\S+) import (\w+) as \2$", re.MULTILINE)


def read_lazy_imports(stub: Path) -> dict[str, str]:
    """Read which module each name of a package is from.

    Args:
        stub: The package's `__init__.pyi`, which type checkers and editors read. Each name has a
            line ``from MODULE import NAME as NAME``.

    Returns:
        The module of each name.
    """
    return {name: module for module, name in _REEXPORT.findall(stub.read_text())}


def lazy_imports(
    package: str, init_file: str
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Make a package's `__getattr__`, `__dir__` and `__all__`.

    Args:
        init_file: Its `__init__.py`; the names are in the `__init__.pyi` beside it.
    """
    modules = read_lazy_imports(Path(init_file).with_suffix(".pyi"))
    names = sorted(modules)

    def get_attribute(name: str) -> object:
        if name not in modules:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(modules[name]), name)

    def list_names() -> list[str]:
        return names

    return get_attribute, list_names, names

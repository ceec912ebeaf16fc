"""Run one benchmark, or list them.

python -m benchmarks                          lists all
python -m benchmarks NAME [OPTIONS]           runs one; --help explains it and lists its variants
python -m benchmarks results KEPT             runs those of docs/results and writes the pages
"""

import ast
import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from benchmarks.harness import run_benchmark


def find_benchmarks() -> dict[str, str]:
    """Return the purpose of each benchmark: the first line of its docstring, by name."""
    files = sorted(Path(__file__).parent.glob("[!_]*.py"))
    sources = {file.stem: file.read_text() for file in files}
    return {
        name: (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
        for name, source in sources.items()
        if "\ndef main(args" in source or "\nVARIANTS: " in source
    }


def main(command_line: Sequence[str]) -> int:
    """Run the benchmark that the first argument names; return its exit code."""
    name, *arguments = command_line or [""]
    purposes = find_benchmarks()
    if name not in purposes:
        print(__doc__)
        print("\n".join(f"{known:20}  {purpose}" for known, purpose in purposes.items()))
        return 2 if name and not name.startswith("-") else 0
    module = import_module(f"benchmarks.{name}")
    return run_benchmark(name, module, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

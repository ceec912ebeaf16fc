"""Run one benchmark, several in a row, or list them.

    python -m benchmarks                          lists all
    python -m benchmarks NAME [OPTIONS]           runs one; --help explains it
    python -m benchmarks all FOLDER [NAME...]     runs the named ones, or all that need no argument

`all` writes the output of each benchmark to FOLDER/NAME.txt and one JSON object per benchmark to
FOLDER/results.jsonl: name, exit code and seconds. The same command leaves out what has succeeded.
"""

import argparse
import ast
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from benchmarks.harness import run_benchmark
from vo_service.terminal import Terminal

RESULTS_FILE = "results.jsonl"


def find_benchmarks() -> dict[str, str]:
    """Return the purpose of each benchmark: the first line of its docstring, by name."""
    files = sorted(Path(__file__).parent.glob("[!_]*.py"))
    sources = {file.stem: file.read_text() for file in files}
    return {
        name: (ast.get_docstring(ast.parse(source)) or "").partition("\n")[0]
        for name, source in sources.items()
        if "\ndef add_arguments(" in source
    }


def needs_no_argument(name: str) -> bool:
    """Whether a benchmark runs without options."""
    parser = argparse.ArgumentParser()
    import_module(f"benchmarks.{name}").add_arguments(parser)
    return not any(action.required for action in parser._actions)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `all`."""
    parser.add_argument("folder", type=Path, help="folder of the results")
    parser.add_argument("names", nargs="*", metavar="NAME", help="benchmarks to run")


def run_all(args: argparse.Namespace) -> int:
    """Run several benchmarks; return 1 if one fails."""
    names = args.names or list(filter(needs_no_argument, find_benchmarks()))
    args.folder.mkdir(parents=True, exist_ok=True)
    results = args.folder / RESULTS_FILE
    done = {
        row["benchmark"]
        for row in map(json.loads, results.read_text().splitlines() if results.exists() else ())
        if row["exit_code"] == 0
    }
    terminal, has_failed = Terminal(), False
    for number, name in enumerate(names, 1):
        if name in done:
            terminal.write_line(f"{name}: done before")
            continue
        begin_s = time.monotonic()
        with (
            (args.folder / f"{name}.txt").open("w") as output,
            terminal.busy(f"{name} ({number} of {len(names)})"),
        ):
            command = [sys.executable, "-m", "benchmarks", name]
            exit_code = subprocess.run(command, stdout=output, check=False).returncode
        has_failed |= exit_code != 0
        row = {
            "benchmark": name,
            "exit_code": exit_code,
            "seconds": round(time.monotonic() - begin_s, 1),
        }
        with results.open("a") as file:
            file.write(f"{json.dumps(row)}\n")
        terminal.write_line(f"{name}: exit code {exit_code}, {row['seconds']} s")
    return int(has_failed)


def main(command_line: Sequence[str]) -> int:
    """Run the benchmark that the first argument names; return its exit code."""
    name, *arguments = command_line or [""]
    if name == "all":
        return run_benchmark("all", __doc__, add_arguments, run_all, arguments)
    purposes = find_benchmarks()
    if name not in purposes:
        print(__doc__)
        print("\n".join(f"{known:20}  {purpose}" for known, purpose in purposes.items()))
        return 2 if name and not name.startswith("-") else 0
    module = import_module(f"benchmarks.{name}")
    return run_benchmark(name, module.__doc__, module.add_arguments, module.main, arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

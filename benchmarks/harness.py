"""The harness of the benchmarks: command line, errors, tables, and results that are kept.

A benchmark is a module with a docstring, which is its help, `add_arguments(parser)` and
`main(args)`, which measures, prints, and returns an exit code or None.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2

from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write

Json = dict[str, Any]


def run_benchmark(
    name: str,
    description: str | None,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    main: Callable[[argparse.Namespace], int | None],
    arguments: Sequence[str] | None = None,
) -> int:
    """Run a benchmark with the options of the command line.

    Args:
        name: Name of the benchmark.
        description: Its help: the docstring of its module.
        add_arguments: Declares its options.
        main: Measures and prints.
        arguments: The options; None: those of this process.

    Returns:
        The exit code: that of `main`, of an error that the user can fix, or 130 after Ctrl-C.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks {name}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_arguments(parser)
    args = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        return main(args) or 0
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; kept results are not measured again", file=sys.stderr)
        return 130


def add_json_option(parser: argparse.ArgumentParser) -> None:
    """Declare --json."""
    parser.add_argument("--json", action="store_true", help="print one JSON object, nothing else")


def make_printer(args: argparse.Namespace) -> Callable[[str], None]:
    """Return a function that prints a line at once; with --json it prints nothing."""
    return (lambda line: None) if args.json else (lambda line: print(line, flush=True))


def format_table(headings: Sequence[str], rows: Mapping[str, Sequence[str]]) -> str:
    """Format aligned columns: the rows' names, then their cells, right-aligned."""
    lines = [("", *headings), *((name, *cells) for name, cells in rows.items())]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    return "\n".join(
        f"{name:<{widths[0]}}"
        + "".join(f"  {cell:>{width}}" for cell, width in zip(cells, widths[1:], strict=True))
        for name, *cells in lines
    )


def print_json(args: argparse.Namespace, results: Mapping[str, object]) -> None:
    """Print the results as one JSON object if --json is given; dataclasses become objects."""
    if args.json:
        print(json.dumps(results, default=asdict))


class ResultCache:
    """JSON objects by name in FOLDER/results.json, written after each."""

    def __init__(self, folder: Path) -> None:
        """Raises InputError if the file was not written by this class."""
        self._file = folder / "results.json"
        self._results: dict[str, Json] = {}
        if self._file.exists():
            self._results = _read(self._file)

    def __contains__(self, name: str) -> bool:
        """Whether there is a result of a name."""
        return name in self._results

    def get_or_run(self, name: str, run: Callable[[], Json]) -> Json:
        """Return the result of a name; run and store it if there is none."""
        if name not in self._results:
            self._results[name] = json.loads(json.dumps(run()))
            atomic_write(self._file, json.dumps(self._results, indent=1).encode())
        return self._results[name]


def _read(file: Path) -> dict[str, Json]:
    try:
        results = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: cannot read it ({error}); name another folder") from error
    if not isinstance(results, dict):
        raise InputError(f"{file}: has no results; name another folder")
    return results

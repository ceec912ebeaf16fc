"""The harness of the benchmarks: command line, errors, times, tables, and results that are kept.

A benchmark is a module whose docstring is its help. It has `main(args)`, which is decorated with
its options, measures, prints, and returns an exit code or None. A benchmark with several variants
has the function of each in `VARIANTS`, by name; the help of a variant is its function's docstring.
"""

import argparse
import json
import os
import re
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from inspect import cleandoc
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import cv2
import numpy as np

from drivers.core import InputError, UserFacingError
from drivers.core.files import atomic_write

Json = dict[str, Any]
Main = Callable[[argparse.Namespace], int | None]
Variants = Mapping[str, Main]
Measure = TypeVar("Measure", bound=Main)
T = TypeVar("T")
Key = TypeVar("Key")


def option(*names: str, **settings: Any) -> Callable[[Measure], Measure]:
    """Give a function that measures an option: the arguments of `ArgumentParser.add_argument`."""

    def add(measure: Measure) -> Measure:
        vars(measure).setdefault("options", []).insert(0, (names, settings))
        return measure

    return add


PROCESSES = option("--processes", type=int, default=os.cpu_count() or 1)
FOLDERS = option("folder", nargs="+", type=Path, help="TUM folder")
RECORDING = option("recording", metavar="RECORDING", type=Path, help="source of the frames")


def run_benchmark(name: str, module: ModuleType, arguments: Sequence[str]) -> int:
    """Run a benchmark with the options of the command line.

    Returns:
        The exit code: that of `main`, of an error that the user can fix, or 130 after Ctrl-C.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m benchmarks {name}",
        description=module.__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if hasattr(module, "VARIANTS"):
        _add_variants(parser, module.VARIANTS)
    else:
        _add_options(parser, module.main)
    args = parser.parse_args(arguments)
    cv2.setNumThreads(1)
    try:
        return int(args.main(args) or 0)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; kept results are not measured again", file=sys.stderr)
        return 130


def _add_variants(parser: argparse.ArgumentParser, variants: Variants) -> None:
    commands = parser.add_subparsers(required=True, metavar="VARIANT")
    for name, main in variants.items():
        description = cleandoc(main.__doc__ or "")
        command = commands.add_parser(
            name,
            help=description.partition("\n")[0],
            description=description,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        _add_options(command, main)


def _add_options(parser: argparse.ArgumentParser, main: Main) -> None:
    for names, settings in vars(main).get("options", []):
        parser.add_argument(*names, **settings)
    parser.set_defaults(main=main)


def measure_cpu_ms(
    work: Callable[[], T], clock_s: Callable[[], float] = time.thread_time
) -> tuple[T, float]:
    """Return the result of some work, and its processor time in milliseconds.

    Args:
        work: What is measured.
        clock_s: The clock: of this thread, or of the whole process.
    """
    begin_s = clock_s()
    result = work()
    return result, 1e3 * (clock_s() - begin_s)


def run_in_turn(cases: Mapping[Key, Callable[[], T]], rounds: int) -> dict[Key, list[T]]:
    """Run each case once a round, so that other load of the machine affects all of them alike."""
    results: dict[Key, list[T]] = {name: [] for name in cases}
    for number in range(1, rounds + 1):
        for name, run in cases.items():
            print(f"round {number} of {rounds}: {name}", file=sys.stderr, flush=True)
            results[name].append(run())
    return results


def combine_runs(runs: Sequence[T], **combine: Callable[[Sequence[Any]], float | None]) -> T:
    """Combine runs of a case, dataclasses of figures: the medians of those that are not None.

    Args:
        runs: The runs.
        combine: For other figures than a median, the function by the field's name: sum, max.
    """
    columns = {name: [getattr(run, name) for run in runs] for name in vars(runs[0])}
    return type(runs[0])(
        **{name: combine.get(name, known_median)(each) for name, each in columns.items()}
    )


def known_median(values: Iterable[float | None]) -> float | None:
    """The median of the values that are not None; None if all are."""
    known = [value for value in values if value is not None]
    return statistics.median(known) if known else None


def median(values: Sequence[float]) -> float:
    """The median; 0 for no values."""
    return float(np.median(values)) if len(values) else 0.0


def median_figure(results: Mapping[str, Json], keys: Sequence[str], figure: str) -> float | None:
    """Median over the runs that have this figure; None if less than half have it."""
    values = [results[key][figure] for key in keys if results[key][figure] is not None]
    return median(values) if 2 * len(values) > len(keys) else None


def format_counts(counts: Sequence[int]) -> str:
    """Format counts of several runs: the median, then the largest if it differs."""
    largest = max(counts)
    return f"{median(counts):g}" + (f"-{largest}" if largest != median(counts) else "")


class Table:
    """A table of fixed columns, whose lines are printed one by one, as the results come."""

    def __init__(self, name_width: int, *columns: str) -> None:
        """Set the columns.

        Args:
            name_width: Width of the first column, with the rows' names.
            columns: Heading and format of each, with its width: "frames:8d", "seconds:8.1f". The
                cells of a format such as "8.1mm" are printed times a thousand: lengths in meters,
                or times in seconds.
        """
        headings, formats = zip(*(column.rsplit(":", 1) for column in columns), strict=True)
        self._formats = [each.replace("mm", "f") for each in formats]
        self._scales = [1e3 if each.endswith("mm") else 1 for each in formats]
        self._name_width = name_width
        self._widths = [int(re.findall(r"\d+", each)[0]) for each in formats]
        self.head = self.text_row("", *headings)

    def text_row(self, name: str, *cells: str) -> str:
        """Format a row of texts, such as the headings."""
        return f"{name:{self._name_width}}" + "".join(
            f"{cell:>{width}}" for cell, width in zip(cells, self._widths, strict=True)
        )

    def row(self, name: str, *cells: float | str | None) -> str:
        """Format a row; a text is right-aligned, and None is "-"."""
        return self.text_row(
            name,
            *(
                "-" if cell is None else cell if isinstance(cell, str) else f"{scale * cell:{form}}"
                for cell, form, scale in zip(cells, self._formats, self._scales, strict=True)
            ),
        )


class ResultCache:
    """JSON objects by name in FOLDER/results.json, written after each."""

    def __init__(self, folder: Path) -> None:
        """Make the folder. Raises InputError if the file was not written by this class."""
        folder.mkdir(parents=True, exist_ok=True)
        self._file = folder / "results.json"
        self._results: dict[str, Json] = {}
        if self._file.exists():
            try:
                self._results = json.loads(self._file.read_text())
            except (OSError, ValueError) as error:
                raise InputError(
                    f"{self._file}: cannot read it ({error}); name another folder"
                ) from error
        if not isinstance(self._results, dict):
            raise InputError(f"{self._file}: has no results; name another folder")

    def __contains__(self, name: str) -> bool:
        """Whether there is a result of a name."""
        return name in self._results

    def get_or_run(self, name: str, run: Callable[[], Json]) -> Json:
        """Return the result of a name; run and store it if there is none."""
        if name not in self._results:
            self._results[name] = json.loads(json.dumps(run()))
            atomic_write(self._file, json.dumps(self._results, indent=1).encode())
        return self._results[name]

"""Parameter sweep of the direct odometry: one changed constant at a time, on some recordings.

    python -m benchmarks direct_sweep KEPT FOLDER... --of NAME=VALUE [NAME=VALUE ...]
    python -m benchmarks direct_sweep KEPT FOLDER... --times 0.5 2

NAME is a constant of vo_service/odometry/direct/parameters.py, VALUE its other value, written as
there. --times multiplies every constant, or each of its parts, by a factor. FOLDER is a TUM folder
with ground truth, FOLDER@5 is every fifth frame of it. Each value runs in a separate process with
its own kernels, which compile for half a minute.

The first row has the current values. For each recording it has the ATE and, in brackets, the mean
global error in millimeters, then frames without a pose and gross errors if there are any. Finished
rows are stored in KEPT/results.json, and the same command continues with the next. Remove KEPT when
the odometry has changed.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.harness import Json, ResultCache
from vo_service.odometry.direct import parameters

BASELINE = "as it is"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("kept", metavar="KEPT", type=Path, help="folder of stored rows")
    parser.add_argument(
        "recording", nargs="+", metavar="FOLDER", help="TUM folder, or FOLDER@EVERY"
    )
    parser.add_argument("--of", nargs="+", default=[], metavar="NAME=VALUE", help="other values")
    parser.add_argument("--times", nargs="+", type=float, default=[], metavar="FACTOR")


def main(args: argparse.Namespace) -> None:
    """Run every value without a stored row, and print all rows."""
    changes = [BASELINE, *args.of]
    for factor in args.times:
        changes += [
            change for name in swept_parameters() if (change := scale_parameter(name, factor))
        ]
    print(f"{'':38}" + "".join(f"{Path(folder).name:>30}" for folder in args.recording))
    args.kept.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(args.kept)
    for change in changes:
        cells = cache.get_or_run(change, partial(run_in_subprocess, change, args.recording))
        print(format_row(change, cells, args.recording), flush=True)


def swept_parameters() -> list[str]:
    """Names of all constants, in the order of the file."""
    return [name for name in vars(parameters) if name.isupper()]


def scale_parameter(name: str, factor: float) -> str:
    """NAME=VALUE with the constant multiplied by `factor`; "" if that does not change it."""
    value = getattr(parameters, name)
    parts = value if isinstance(value, tuple) else (value,)
    changed = tuple(
        max(1, round(part * factor)) if isinstance(part, int) else float(f"{part * factor:.6g}")
        for part in parts
    )
    return "" if changed == parts else f"{name}={changed if len(changed) > 1 else changed[0]}"


def run_in_subprocess(change: str, recordings: Sequence[str]) -> Json:
    """Compute the cells of one row; after a failure its reason under "failed"."""
    with tempfile.TemporaryDirectory() as cache:
        result = subprocess.run(
            [sys.executable, "-m", "benchmarks.direct_sweep_row", change, *recordings],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
        )
    if result.returncode != 0:
        return {"failed": result.stderr.strip().splitlines()[-1]}
    cells: Json = json.loads(result.stdout)
    return cells


def parse_change(change: str) -> tuple[str, object]:
    """Parse NAME=VALUE."""
    name, _, value = change.partition("=")
    return name, ast.literal_eval(value)


def format_row(change: str, cells: Json, recordings: Sequence[str]) -> str:
    """One row of the table.

    Args:
        change: The change, "NAME=VALUE".
        cells: Results by recording, or the failure.
        recordings: The columns.
    """
    if "failed" in cells:
        return f"{change:38}  failed: {cells['failed']}"
    return f"{change:38}" + "".join(f"{_cell(cells.get(each)):>30}" for each in recordings)


def _cell(figures: Json | None) -> str:
    if figures is None:
        return "-"
    text = f"{1e3 * figures['ate_m']:.2f} ({1e3 * figures['global_m']:.2f})"
    text += f" lost {figures['lost']}" if figures["lost"] else ""
    return text + (f" gross {figures['gross']}" if figures["gross"] else "")

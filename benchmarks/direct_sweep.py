"""What the constants of the keyframe odometry do: other values, one at a time, on some recordings.

    python -m benchmarks.direct_sweep KEPT FOLDER... --of NAME=VALUE [NAME=VALUE ...]
    python -m benchmarks.direct_sweep KEPT FOLDER... --times 0.5 2

NAME is one of vo_service/odometry/direct/parameters.py, VALUE what it is to be instead, written
as there; --times takes every constant so many times, its parts where it has several. FOLDER is a
TUM folder with ground truth, FOLDER@5 every fifth frame of it. Each value runs in a process of its
own, with kernels of its own: compiling takes half a minute.

The first row is as it is. For each recording: ATE and, in brackets, the mean global error in
millimetres, then frames without a pose and gross errors where there are any. Rows are kept in
KEPT/results.json as they are done; the same command goes on with the next. Remove KEPT when the
odometry has changed.
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

from benchmarks.result_cache import Json, ResultCache
from drivers.core.errors import UserFacingError
from vo_service.odometry.direct import parameters

BASELINE = "as it is"


def main() -> int:
    """Run every value that is not kept yet, and print a row for each."""
    args = _parser().parse_args()
    changes = [BASELINE, *args.of]
    for factor in args.times:
        changes += [
            change for name in swept_parameters() if (change := scale_parameter(name, factor))
        ]
    print(f"{'':38}" + "".join(f"{Path(folder).name:>30}" for folder in args.recording))
    try:
        args.kept.mkdir(parents=True, exist_ok=True)
        kept = ResultCache(args.kept)
        for change in changes:
            found = kept.get_or_run(change, partial(run_in_subprocess, change, args.recording))
            print(format_row(change, found, args.recording), flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command goes on with the next value", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.direct_sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kept", metavar="KEPT", type=Path, help="where rows are kept")
    parser.add_argument("recording", nargs="+", metavar="FOLDER", help="or FOLDER@EVERY")
    parser.add_argument("--of", nargs="+", default=[], metavar="NAME=VALUE", help="other values")
    parser.add_argument("--times", nargs="+", type=float, default=[], metavar="FACTOR")
    return parser


def swept_parameters() -> list[str]:
    """Names of all that were chosen by measurement, in the order in which they stand."""
    return [name for name in vars(parameters) if name.isupper()]


def scale_parameter(name: str, factor: float) -> str:
    """NAME=VALUE so many times what it is; "" where that is no other value."""
    value = getattr(parameters, name)
    parts = value if isinstance(value, tuple) else (value,)
    changed = tuple(
        max(1, round(part * factor)) if isinstance(part, int) else float(f"{part * factor:.6g}")
        for part in parts
    )
    return "" if changed == parts else f"{name}={changed if len(changed) > 1 else changed[0]}"


def run_in_subprocess(change: str, recordings: Sequence[str]) -> Json:
    """The cells of one row; of a failure the reason."""
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.direct_sweep_row", change, *recordings],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
        )
    if done.returncode != 0:
        return {"failed": done.stderr.strip().splitlines()[-1]}
    cells: Json = json.loads(done.stdout)
    return cells


def parse_change(change: str) -> tuple[str, object]:
    """Name and value of NAME=VALUE."""
    name, _, value = change.partition("=")
    return name, ast.literal_eval(value)


def format_row(change: str, found: Json, recordings: Sequence[str]) -> str:
    """One row of the table."""
    if "failed" in found:
        return f"{change:38}  failed: {found['failed']}"
    return f"{change:38}" + "".join(f"{_cell(found.get(each)):>30}" for each in recordings)


def _cell(figures: Json | None) -> str:
    if figures is None:
        return "-"
    text = f"{1e3 * figures['ate_m']:.2f} ({1e3 * figures['global_m']:.2f})"
    text += f" lost {figures['lost']}" if figures["lost"] else ""
    return text + (f" gross {figures['gross']}" if figures["gross"] else "")


if __name__ == "__main__":
    sys.exit(main())

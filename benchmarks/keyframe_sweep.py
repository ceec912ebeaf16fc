"""What the constants of the keyframe odometry do: other values, one at a time, on some recordings.

    python -m benchmarks.keyframe_sweep FOLDER... --of NAME=VALUE [NAME=VALUE ...] [--every 1 5]

NAME is one of vo_service/odometry/keyframe/parameters.py, VALUE what it is to be instead, written
as there. Each runs in a process of its own, with kernels of its own: compiling takes half a minute.
The first row is as it is. For each recording: ATE, mean global error and RPE over a second, in
millimetres, and the frames without a pose.
"""

import argparse
import ast
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

AS_IT_IS = "as it is"
MODULE = "vo_service.odometry.keyframe.parameters"


def main() -> int:
    """Run every value, and print a row for each as it is done."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.keyframe_sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="+", type=Path, help="TUM folder with ground truth")
    parser.add_argument("--of", nargs="+", default=[], metavar="NAME=VALUE", help="other values")
    parser.add_argument("--every", nargs="+", type=int, default=[1], help="every so-manieth frame")
    args = parser.parse_args()
    heads = [f"{folder.name}/{every}" for folder in args.folder for every in args.every]
    print(f"{'':34}" + "".join(f"{head:>30}" for head in heads), flush=True)
    for change in [AS_IT_IS, *args.of]:
        print(f"{change:34}" + in_a_child(change, args.folder, args.every), flush=True)
    return 0


def in_a_child(change: str, folders: list[Path], every: list[int]) -> str:
    """One row; the cells as text."""
    with tempfile.TemporaryDirectory() as cache:
        settings = json.dumps([change, [str(folder) for folder in folders], every])
        done = subprocess.run(
            [sys.executable, "-m", "benchmarks.keyframe_sweep_row", settings],
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
            capture_output=True,
            text=True,
        )
    lines = done.stderr.strip().splitlines()
    return done.stdout.rstrip("\n") if done.returncode == 0 else f"  failed: {lines[-1]}"


def changed(change: str) -> tuple[str, object]:
    """Name and value of NAME=VALUE."""
    name, _, value = change.partition("=")
    return name, ast.literal_eval(value)


if __name__ == "__main__":
    sys.exit(main())

"""Consistency of a method's covariance: its errors compared with the covariance it reports.

    python -m benchmarks.covariance FOLDER... [--method direct] [--every N] [--json]
    python -m benchmarks.covariance --rooms FOLDER [--seeds 101 102 ...]

Each FOLDER is a TUM folder with an exact ground truth. --rooms renders five seconds for each seed
and stores them in FOLDER; room, motion and sensor timing differ. "since" is the motion since the
reference (for `direct` the keyframe). "step" is the motion since the previous frame, with the
covariance that the service publishes for it. "mean" is the normalized squared error (NEES) per
degree of freedom: 1 is consistent, more is overconfident. "in 95 %" is how often the 95 % ellipsoid
contains the truth.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path

import cv2

from benchmarks.covariance_measure import NormalizedErrors, measure
from benchmarks.covariance_sequences import SEEDS, make_configs
from benchmarks.rendered_sequences import render_all
from drivers.core.errors import InputError, UserFacingError
from vo_service.odometry.registry import METHODS
from vo_service.tools.evaluation.consistency import NeesStatistics, summarize_nees

ConsistencyRow = Mapping[str, NeesStatistics | None]

HEAD = f"{'':42}{'motions':>8}{'since: mean':>13}{'in 95 %':>9}{'step: mean':>12}{'in 95 %':>9}"


def main() -> int:
    """Render missing rooms, measure and print."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        results = run(_folders(args), args.method, args.every, silent=args.json)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if args.json:
        print(json.dumps(results, default=asdict))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.covariance",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", nargs="*", type=Path, help="TUM folder with ground truth")
    parser.add_argument(
        "--rooms", type=Path, metavar="FOLDER", help="render rooms into this folder"
    )
    parser.add_argument("--seeds", nargs="+", type=int, default=SEEDS, help="seeds of the rooms")
    parser.add_argument("--processes", type=int, default=1, help="rendering processes")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--every", type=int, default=1, help="use every N-th frame")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _folders(args: argparse.Namespace) -> list[Path]:
    """Folders to measure; missing rooms are rendered."""
    if args.rooms is None:
        if not args.folder:
            raise InputError("nothing to measure: name a folder, or --rooms FOLDER")
        return list(args.folder)
    wanted = {args.rooms / name: config for name, config in make_configs(args.seeds).items()}
    args.rooms.mkdir(parents=True, exist_ok=True)
    render_all(wanted, lambda line: print(line, file=sys.stderr, flush=True), args.processes)
    return [*args.folder, *wanted]


def _print_line(line: str) -> None:
    print(line, flush=True)


def run(folders: list[Path], method: str, every: int, silent: bool) -> dict[str, ConsistencyRow]:
    """Measure each folder; return a row for each and one for all together."""
    print_line: Callable[[str], None] = (lambda line: None) if silent else _print_line
    print_line(HEAD)
    together, results = NormalizedErrors(), dict[str, ConsistencyRow]()
    for folder in folders:
        squares = measure(method, folder, every)
        together.extend(squares)
        results[str(folder)] = _consistency_row(squares)
        print_line(_format_row(folder.name, results[str(folder)]))
    results["together"] = _consistency_row(together)
    print_line(_format_row("together", results["together"]))
    return results


def _consistency_row(squares: NormalizedErrors) -> ConsistencyRow:
    return {"since": summarize_nees(squares.since_reference), "step": summarize_nees(squares.step)}


def _format_row(name: str, row: ConsistencyRow) -> str:
    since, step = row["since"], row["step"]
    if since is None or step is None:
        return f"{name:42}{0:8}"
    return (
        f"{name:42}{since.count:8}{since.mean_per_dof:13.2f}{100 * since.fraction_within_95:9.1f}"
        f"{step.mean_per_dof:12.2f}{100 * step.fraction_within_95:9.1f}"
    )


if __name__ == "__main__":
    sys.exit(main())

"""Tracking in hard cases: a table with one row for each case.

    python -m benchmarks.hard_cases FOLDER [--method direct] [--only dark wall] [--json]

FOLDER stores the sequences of config/sequences, which are rendered the first time (twenty minutes
of one core). A gross error is a step with an error above 5 cm or 3 degrees; in brackets are those
at a frame in state `tracking`. "longest" is the longest time without a pose. "recovery" is the
longest time from the end of a fault until a frame in state `tracking`. ATE and largest error are
over all poses, in millimeters. "slow" creeps at a millimeter per second for a minute. "still"
stands still for --still-frames frames with fresh noise in each (an hour is 108000).
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path

import cv2

from benchmarks.hard_cases_measure import HardCaseResult, measure
from benchmarks.rendered_sequences import render_all
from benchmarks.slow_cases_measure import (
    CreepResult,
    StationaryResult,
    measure_creep,
    measure_stationary,
)
from benchmarks.static_views import StaticView
from drivers.core.errors import UserFacingError
from drivers.synthetic.config import SyntheticConfig
from vo_service.config import read_config
from vo_service.odometry.registry import METHODS, warm_up

SEQUENCES = Path(__file__).parents[1] / "config" / "sequences"
SLOW, STILL = "slow", "still"
FAULT_CASES = (
    "object-8",
    "object-20",
    "person",
    "wall",
    "dark",
    "covered",
    "gap",
    "fast-turn",
    "floor",
)
CASES = (*FAULT_CASES, SLOW, STILL)
STILL_FRAMES = 9000
HEAD = (
    f"{'':12}{'frames':>8}{'degraded':>10}{'lost':>6}{'epochs':>8}{'gross':>9}{'longest s':>11}"
    f"{'recovery s':>12}{'ATE':>8}{'largest':>9}"
)

CaseResult = HardCaseResult | CreepResult | StationaryResult


def main() -> int:
    """Render, measure and print."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    silent = args.json
    print_line: Callable[[str], None] = (lambda line: None) if silent else _print_line
    try:
        results = run(args.folder, args.method, args.only, args.still_frames, print_line)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    if silent:
        print(json.dumps(results, default=asdict))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.hard_cases",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="folder of the sequences")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--only", nargs="+", choices=CASES, default=CASES, metavar="CASE")
    parser.add_argument("--still-frames", type=int, default=STILL_FRAMES)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def _print_line(line: str) -> None:
    print(line, flush=True)


def run(
    folder: Path,
    method: str,
    names: list[str],
    still_frames: int,
    print_line: Callable[[str], None],
) -> Mapping[str, CaseResult]:
    """Measure each case and print its row. Raises as `render_all`."""
    configs = {name: case_config(name) for name in names}
    folder.mkdir(parents=True, exist_ok=True)
    longest_first = sorted(names, key=lambda name: -configs[name].frame_count)
    sequences = {folder / name: configs[name] for name in longest_first if name != STILL}
    render_all(sequences, print_line, os.cpu_count() or 1)
    warm_up(method, lambda stage: None)
    results: dict[str, CaseResult] = {}
    for name in (name for name in CASES if name in names):
        if not results:
            print_line(f"{method}\n{HEAD}")
        results[name] = _measure_case(name, folder / name, configs[name], method, still_frames)
        print_line(f"{name:12}{format_row(results[name])}")
    return results


def case_config(name: str) -> SyntheticConfig:
    """Read the configuration of a case."""
    return replace(read_config(SEQUENCES / f"{name}.toml").synthetic, loop=False)


def _measure_case(
    name: str, folder: Path, config: SyntheticConfig, method: str, still_frames: int
) -> CaseResult:
    if name == STILL:
        return measure_stationary(method, StaticView.render(config).frames(still_frames))
    if name == SLOW:
        return measure_creep(method, folder)
    return measure(method, folder, config)


def format_row(figures: CaseResult) -> str:
    """One row of the table, without the name."""
    match figures:
        case HardCaseResult():
            gross = f"{figures.gross} ({figures.gross_tracking})"
            return (
                f"{figures.frames:8}{figures.degraded:10}{figures.lost:6}{figures.epochs:8}"
                f"{gross:>9}{figures.longest_gap_s:11.2f}"
                f"{_format_number(figures.recovery_s, 1.0, 12, 2)}"
                f"{_format_number(figures.ate_m, 1e3, 8, 1)}"
                f"{_format_number(figures.max_error_m, 1e3, 9, 1)}"
            )
        case CreepResult():
            share = 100.0 * figures.tracked_distance_m / figures.true_distance_m
            return (
                f"{figures.frames:8}{'':10}{figures.lost:6}    "
                f"{1e3 * figures.tracked_distance_m:.2f} of "
                f"{1e3 * figures.true_distance_m:.2f} mm: {share:.1f} %"
            )
        case StationaryResult():
            return (
                f"{figures.frames:8}{'':10}{figures.lost:6}    "
                f"at most {1e3 * figures.max_error_m:.3f} mm and "
                f"{figures.max_error_deg:.4f} degrees away, in the end "
                f"{1e3 * figures.end_m:.3f} mm and {figures.end_deg:.4f} degrees"
            )


def _format_number(value: float | None, scale: float, width: int, digits: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{scale * value:{width}.{digits}f}"


if __name__ == "__main__":
    sys.exit(main())

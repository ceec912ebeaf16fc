"""Whether a robot that is started again knows where it is in the map of the day before.

    python -m benchmarks.multi_session FOLDER [--seeds 1 2 3 4 5] [--starts 20]

The first day is the first half of a tour of a minute. Its places are written to a file. On the
second day the file is read, and the odometry begins anew somewhere in the other half, which comes
by the same places on other ways: as often as is asked for, evenly spread, and for ten seconds at
most. Each seed is another room; its film (2.8 GB) is that of `benchmarks.relocalization`, if FOLDER
is the same. Outcomes are kept in FOLDER/results.json; remove that file to begin anew.

"known" counts the starts after which it was known where the camera is, "frames" is the median time
until then. "median" and "largest" (mm, degrees) are errors in the first day's map at that moment,
with what that map itself is off by; "near" is the largest as seen from its nearest place, without
that. "a second later" is the largest of the first within the next second. "wrong" is off by more
than 5 cm or 3 degrees.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import sys
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from benchmarks.multi_session_measure import (
    MAX_FRAMES,
    SessionStartResult,
    TourSequence,
    build_map,
    relocalize_in_map,
)
from benchmarks.relocalization import SEQUENCE_S
from benchmarks.relocalization_trials import open_cached_sequence
from benchmarks.result_cache import Json, ResultCache
from benchmarks.tour_frames import compute_true_poses, make_tour_config
from drivers.core.errors import UserFacingError
from vo_service.odometry.registry import METHODS
from vo_service.odometry.warm_up import warm_up
from vo_service.terminal import Terminal

HEAD = (
    f"{'':12}{'starts':>8}{'known':>8}{'wrong':>8}{'frames':>8}{'median':>9}{'largest':>9}{'deg':>7}"
    f"{'near':>7}{'a second later':>16}{'deg':>7}"
)


def main() -> int:
    """Run the seeds that are not finished yet, and print all of them."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        run(args)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command goes on with the next seed", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.multi_session",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="where films, maps and outcomes are kept")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--starts", type=int, default=20, help="of each seed")
    parser.add_argument("--method", choices=METHODS, default="direct")
    return parser


def run(args: argparse.Namespace) -> list[SessionStartResult]:
    """All outcomes. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    kept, together = ResultCache(args.folder), list[SessionStartResult]()
    warm_up(args.method, lambda stage: None)
    print(HEAD)
    for seed in args.seeds:
        name = f"next-day-{seed}-{args.method}-{args.starts}"
        found = kept.get_or_run(name, partial(_measure, args, seed))
        outcomes = [SessionStartResult(**each) for each in found["outcomes"]]
        together += outcomes
        print(format_row(f"seed {seed}", outcomes), flush=True)
    print(format_row("together", together))
    return together


def _measure(args: argparse.Namespace, seed: int) -> Json:
    terminal, config = Terminal(), make_tour_config(seed, SEQUENCE_S, False)
    tour = TourSequence(
        config, open_cached_sequence(args.folder, config, terminal), compute_true_poses(config)
    )
    file = args.folder / f"day-{seed}.places"
    T_room_map = build_map(args.method, tour, file)
    starts = np.linspace(
        tour.second_half_start, len(tour.T_room_camera) - MAX_FRAMES, args.starts, dtype=np.int64
    )
    outcomes = []
    for number, first in enumerate(starts, 1):
        terminal.progress(f"room {seed}: start", number, args.starts)
        outcomes.append(relocalize_in_map(args.method, tour, file, T_room_map, int(first)))
    terminal.clear()
    return {"outcomes": [asdict(each) for each in outcomes]}


def format_row(name: str, outcomes: Sequence[SessionStartResult]) -> str:
    """One row of the table."""
    known = [each for each in outcomes if each.frames is not None]
    counts = (len(outcomes), len(known), sum(each.is_wrong for each in known))
    row = f"{name:12}{''.join(f'{count:8}' for count in counts)}"
    if not known:
        return row
    frames = np.median([each.frames for each in known])
    away_mm = [1e3 * each.error_m for each in known]
    later_mm = [1e3 * each.settled_error_m for each in known]
    away_deg, later_deg = (
        [each.error_deg for each in known],
        [each.settled_error_deg for each in known],
    )
    return (
        f"{row}{frames:8.0f}{np.median(away_mm):9.1f}{max(away_mm):9.1f}{max(away_deg):7.2f}"
        f"{1e3 * max(each.nearby_error_m for each in known):7.1f}{max(later_mm):16.1f}{max(later_deg):7.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())

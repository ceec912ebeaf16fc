"""Relocalization of a restarted robot in the map of an earlier session.

    python -m benchmarks.multi_session FOLDER [--seeds 1 2 3 4 5] [--starts 20]

The first session is the first half of a tour of a minute; its map is saved to a file. In the second
session the map is loaded and the odometry starts in the other half, which passes the same places on
another path. There are --starts evenly spread starts of ten seconds at most. Each seed is another
room; its frames (2.8 GB) are shared with `benchmarks.relocalization` if FOLDER is the same. Results
are stored in FOLDER/results.json; remove that file to measure again.

"known" counts the starts that relocalize, and "frames" is the median time until then. "median" and
"largest" (mm, degrees) are errors in the saved map at that time, including the map's own error.
"near" is the largest error relative to the nearest keyframe, without the map's error. "a second
later" is the largest error within the next second. "wrong" is above 5 cm or 3 degrees.
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
from vo_service.odometry.registry import METHODS, warm_up
from vo_service.terminal import Terminal

HEAD = (
    f"{'':12}{'starts':>8}{'known':>8}{'wrong':>8}{'frames':>8}{'median':>9}{'largest':>9}{'deg':>7}"
    f"{'near':>7}{'a second later':>16}{'deg':>7}"
)


def main() -> int:
    """Run the seeds without stored results, and print all."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        run(args)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command continues with the next seed", file=sys.stderr)
        return 130
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.multi_session",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="folder of rendered frames, maps and results")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--starts", type=int, default=20, help="starts of each seed")
    parser.add_argument("--method", choices=METHODS, default="direct")
    return parser


def run(args: argparse.Namespace) -> list[SessionStartResult]:
    """Run all seeds. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache, together = ResultCache(args.folder), list[SessionStartResult]()
    warm_up(args.method, lambda stage: None)
    print(HEAD)
    for seed in args.seeds:
        name = f"next-day-{seed}-{args.method}-{args.starts}"
        result = cache.get_or_run(name, partial(_measure, args, seed))
        outcomes = [SessionStartResult(**each) for each in result["outcomes"]]
        together += outcomes
        print(format_row(f"seed {seed}", outcomes), flush=True)
    print(format_row("together", together))
    return together


def _measure(args: argparse.Namespace, seed: int) -> Json:
    terminal, config = Terminal(), make_tour_config(seed, SEQUENCE_S, False)
    tour = TourSequence(
        config, open_cached_sequence(args.folder, config, terminal), compute_true_poses(config)
    )
    file = args.folder / f"day-{seed}.keyframes"
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
    error_mm = [1e3 * each.error_m for each in known]
    settled_mm = [1e3 * each.settled_error_m for each in known]
    error_deg, settled_deg = (
        [each.error_deg for each in known],
        [each.settled_error_deg for each in known],
    )
    return (
        f"{row}{frames:8.0f}{np.median(error_mm):9.1f}{max(error_mm):9.1f}{max(error_deg):7.2f}"
        f"{1e3 * max(each.nearby_error_m for each in known):7.1f}"
        f"{max(settled_mm):16.1f}{max(settled_deg):7.2f}"
    )


if __name__ == "__main__":
    sys.exit(main())

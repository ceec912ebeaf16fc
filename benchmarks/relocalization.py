"""Whether a camera that is covered, and uncovered somewhere else, knows where it is.

    python -m benchmarks.relocalization FOLDER [--tries 100] [--seeds 1 2 3] [--unseen] [--twins]

In each try the camera goes along a tour for 20 s, is covered for 3 s, and is uncovered at a place
that it has seen before, on another lap; with --unseen at one that it has not. How much of a view
was seen before is known from true poses and measured depth. Each seed is another room; its film of
a minute (2.8 GB) is kept in FOLDER/films, and rendered the first time: two minutes on two idle
cores. A try takes five seconds. The outcomes of each seed are kept in FOLDER/results.json and not
measured again; remove that file to begin anew.

"old" counts the tries that came back into the world from before the cover, "in 1 s" those of them
that did so within 30 frames, "new" those with a new world, "nowhere" those without any pose in 2 s.
"wrong" has a pose that is off by more than 5 cm or 3 degrees and does not say so: in the old world
by the truth at that place, in a new one by the way since its first pose. "frames" is the median
time until the first pose; "median", "largest" (mm) and "deg" are its errors where it is an old one.
"""

import benchmarks.one_thread  # noqa: F401

# isort: split

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from benchmarks.relocalization_measure import (
    RelocalizationOutcome,
    RelocalizationSummary,
    run_trial,
    summarize,
)
from benchmarks.relocalization_trials import (
    choose_trials,
    open_cached_sequence,
    sample_views,
    trial_frames,
)
from benchmarks.result_cache import Json, ResultCache
from benchmarks.runners import make_runner
from benchmarks.tour_frames import compute_true_poses, make_tour_config
from drivers.core.errors import UserFacingError
from vo_service.odometry.registry import METHODS
from vo_service.odometry.warm_up import warm_up
from vo_service.terminal import Terminal

# Two laps.
SEQUENCE_S = 60.0
COLUMNS = (
    "tries",
    "old",
    "in 1 s",
    "new",
    "nowhere",
    "wrong",
    "frames",
    "median",
    "largest",
    "deg",
)
HEAD = f"{'':28}{''.join(f'{head:>9}' for head in COLUMNS)}"


def main() -> int:
    """Run the seeds that are not finished yet, and print all of them, then all together."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        results = run(args)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command goes on with the next seed", file=sys.stderr)
        return 130
    if args.json:
        print(json.dumps({name: asdict(each) for name, each in results.items()}))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.relocalization",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("folder", type=Path, help="where films and outcomes are kept")
    parser.add_argument("--tries", type=int, default=100, help="of all seeds together")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument("--unseen", action="store_true", help="uncovered where it never was")
    parser.add_argument("--twins", action="store_true", help="two corners look the same")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--alone", action="store_true", help="the odometry, without any place")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def run(args: argparse.Namespace) -> Mapping[str, RelocalizationSummary]:
    """By seed, and together. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    kept = ResultCache(args.folder)
    warm_up(args.method, lambda stage: None)
    results, together = dict[str, RelocalizationSummary](), list[RelocalizationOutcome]()
    if not args.json:
        print(HEAD)
    for place, seed in enumerate(args.seeds):
        share = args.tries // len(args.seeds) + (place < args.tries % len(args.seeds))
        seen = "unseen" if args.unseen else "seen"
        alone = "-alone" if args.alone else ""
        name = f"{'twins' if args.twins else 'tour'}-{seed}-{seen}-{args.method}{alone}"
        found = kept.get_or_run(f"{name}-{share}", partial(_measure, args, seed, share))
        outcomes = [RelocalizationOutcome(**each) for each in found["outcomes"]]
        together += outcomes
        results[name] = summarize(outcomes)
        if not args.json:
            print(format_row(name, results[name]), flush=True)
    results["together"] = summarize(together)
    if not args.json:
        print(format_row("together", results["together"]))
    return results


def _measure(args: argparse.Namespace, seed: int, count: int) -> Json:
    """The tries of one seed and their outcomes."""
    terminal, config = Terminal(), make_tour_config(seed, SEQUENCE_S, args.twins)
    T_room_camera = compute_true_poses(config)
    film = open_cached_sequence(args.folder, config, terminal)
    rng = np.random.default_rng([seed, 12])
    tries = choose_trials(sample_views(config, film, T_room_camera), count, args.unseen, rng)
    outcomes: list[RelocalizationOutcome] = []
    for number, each in enumerate(tries, 1):
        terminal.progress(f"room {seed}: try", number, len(tries))
        truth = T_room_camera[each.source_frames]
        frames = trial_frames(each, config, film)
        outcomes.append(
            run_trial(
                make_runner(args.method, args.alone), frames, truth, each.overlap_frame - each.first
            )
        )
    terminal.clear()
    return {"tries": list(map(asdict, tries)), "outcomes": list(map(asdict, outcomes))}


def format_row(name: str, result: RelocalizationSummary) -> str:
    """One row of the table."""
    counts = (
        result.trials,
        result.old_map,
        result.prompt,
        result.new_map,
        result.nowhere,
        result.wrong,
    )
    figures = (
        (result.median_frames, 1.0),
        (result.median_m, 1e3),
        (result.largest_m, 1e3),
        (result.largest_deg, 1.0),
    )
    cells = [str(count) for count in counts]
    cells += ["-" if value is None else f"{scale * value:.1f}" for value, scale in figures]
    return f"{name:28}{''.join(f'{cell:>9}' for cell in cells)}"


if __name__ == "__main__":
    sys.exit(main())

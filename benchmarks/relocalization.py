"""Relocalization of a camera that is covered and then uncovered at another place.

    python -m benchmarks.relocalization FOLDER [--tries 100] [--seeds 1 2 3] [--unseen] [--twins]

In each trial the camera follows a tour for 20 s, is covered for 3 s, and is uncovered at a place
that it saw before on another lap; with --unseen at a place that it did not see. View overlap is
computed from true poses and measured depth. Each seed is another room. Its frames of a minute
(2.8 GB) are stored in FOLDER/sequences and rendered the first time: two minutes on two idle
cores. A trial takes five seconds. The results of each seed are stored in FOLDER/results.json;
remove that file to measure again.

"old" counts the trials that relocalize in the map from before the cover, "in 1 s" those of them
within 30 frames, "new" those with a new map, "nowhere" those without a pose in 2 s. "wrong" has a
pose with an unreported error above 5 cm or 3 degrees: in the old map compared with the truth at
that place, in a new map with the motion since its first pose. "frames" is the median time until
the first pose. "median", "largest" (mm) and "deg" are its errors in the old map.
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
from vo_service.odometry.registry import METHODS, warm_up
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
    """Run the seeds without stored results; print all of them, then all together."""
    args = _parser().parse_args()
    cv2.setNumThreads(1)
    try:
        results = run(args)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        print("stopped; the same command continues with the next seed", file=sys.stderr)
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
    parser.add_argument("folder", type=Path, help="folder of rendered frames and results")
    parser.add_argument("--tries", type=int, default=100, help="trials of all seeds together")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument(
        "--unseen", action="store_true", help="uncover the camera at places that it did not see"
    )
    parser.add_argument("--twins", action="store_true", help="two corners look the same")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--alone", action="store_true", help="only the odometry, without a map")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    return parser


def run(args: argparse.Namespace) -> Mapping[str, RelocalizationSummary]:
    """Results by seed, and together. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(args.folder)
    warm_up(args.method, lambda stage: None)
    results, together = dict[str, RelocalizationSummary](), list[RelocalizationOutcome]()
    if not args.json:
        print(HEAD)
    for index, seed in enumerate(args.seeds):
        count = args.tries // len(args.seeds) + (index < args.tries % len(args.seeds))
        seen = "unseen" if args.unseen else "seen"
        alone = "-alone" if args.alone else ""
        name = f"{'twins' if args.twins else 'tour'}-{seed}-{seen}-{args.method}{alone}"
        result = cache.get_or_run(f"{name}-{count}", partial(_measure, args, seed, count))
        outcomes = [RelocalizationOutcome(**each) for each in result["outcomes"]]
        together += outcomes
        results[name] = summarize(outcomes)
        if not args.json:
            print(format_row(name, results[name]), flush=True)
    results["together"] = summarize(together)
    if not args.json:
        print(format_row("together", results["together"]))
    return results


def _measure(args: argparse.Namespace, seed: int, count: int) -> Json:
    """Run the trials of one seed."""
    terminal, config = Terminal(), make_tour_config(seed, SEQUENCE_S, args.twins)
    T_room_camera = compute_true_poses(config)
    sequence = open_cached_sequence(args.folder, config, terminal)
    rng = np.random.default_rng([seed, 12])
    trials = choose_trials(sample_views(config, sequence, T_room_camera), count, args.unseen, rng)
    outcomes: list[RelocalizationOutcome] = []
    for number, trial in enumerate(trials, 1):
        terminal.progress(f"room {seed}: trial", number, len(trials))
        truth = T_room_camera[trial.source_frames]
        frames = trial_frames(trial, config, sequence)
        outcomes.append(
            run_trial(
                make_runner(args.method, args.alone),
                frames,
                truth,
                trial.overlap_frame - trial.first,
            )
        )
    terminal.clear()
    return {"tries": list(map(asdict, trials)), "outcomes": list(map(asdict, outcomes))}


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

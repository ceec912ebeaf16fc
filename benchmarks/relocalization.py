"""Relocalization of a camera that is covered and then uncovered at another place.

    python -m benchmarks relocalization FOLDER [--tries 100] [--seeds 1 2 3] [--unseen] [--twins]

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

import argparse
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.harness import Json, ResultCache, add_json_option, make_printer, print_json
from benchmarks.relocalization_trials import (
    FRAMES_BEFORE,
    FRAMES_COVERED,
    choose_trials,
    open_cached_sequence,
    sample_views,
    trial_frames,
)
from benchmarks.rendered_views import compute_true_poses, make_tour_config
from benchmarks.tour_record import TrajectoryRunner, make_runner
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, pose_distance
from vo_service.odometry import METHODS, warm_up
from vo_service.terminal import Terminal
from vo_service.tools.evaluation.metrics import GROSS_ERROR_DEG, GROSS_ERROR_M
from vo_service.types import Estimate

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


@dataclass(frozen=True)
class RelocalizationOutcome:
    """Result of one trial.

    Attributes:
        tracked: Whether the last frame before the cover had a pose.
        frames: Frames from the first uncovered one to the first with a pose, both counted; None
            if there was none.
        is_old_map: Whether that pose is in the map from before the cover.
        error_m: Position error of that pose in the old map; None in a new one.
        error_deg: Its rotation error.
        is_wrong: Whether a pose after the cover has an error above 5 cm or 3 degrees, in the old
            map or relative to the first pose of its new map.
    """

    tracked: bool
    frames: int | None
    is_old_map: bool
    error_m: float | None
    error_deg: float | None
    is_wrong: bool


@dataclass(frozen=True)
class RelocalizationSummary:
    """Summary of trials; `prompt` counts those in the old map within MAX_PROMPT_FRAMES."""

    trials: int
    tracked: int
    old_map: int
    prompt: int
    new_map: int
    nowhere: int
    wrong: int
    median_frames: float | None
    median_m: float | None
    largest_m: float | None
    largest_deg: float | None


MAX_PROMPT_FRAMES = 30


def _run_trial(
    runner: TrajectoryRunner, frames: Iterable[RgbdFrame], T_room_camera: Array, overlap_frame: int
) -> RelocalizationOutcome:
    """Run one trial; the other arguments are as for `evaluate_trial`."""
    estimates = []
    for frame in frames:
        estimates.append(runner.estimate_pose(frame))
        runner.update_map()
    return evaluate_trial(estimates, T_room_camera, overlap_frame)


def evaluate_trial(
    estimates: Sequence[Estimate], T_room_camera: Array, overlap_frame: int
) -> RelocalizationOutcome:
    """Evaluate the estimates of a trial.

    The old map is aligned with the room at `overlap_frame`, so that drift elsewhere is not an error
    of the relocalization. A new map is aligned at its first pose.

    Args:
        estimates: F estimates.
        T_room_camera: True poses (F, 4, 4).
        overlap_frame: The frame before the cover that shows most of the place of the return.
    """
    epochs = np.cumsum([estimate.is_reset for estimate in estimates])
    old, errors = epochs[FRAMES_BEFORE - 1], dict[int, tuple[float, float]]()
    aligned = overlap_frame if epochs[overlap_frame] == old else FRAMES_BEFORE - 1
    T_room_world = {old: T_room_camera[aligned] @ inverse(estimates[aligned].T_world_camera)}
    for number in range(FRAMES_BEFORE + FRAMES_COVERED, len(estimates)):
        if estimates[number].ok:
            T_world_camera, T_room = estimates[number].T_world_camera, T_room_camera[number]
            T = T_room_world.setdefault(epochs[number], T_room @ inverse(T_world_camera))
            distance_m, angle_rad = pose_distance(T_room, T @ T_world_camera)
            errors[number] = distance_m, math.degrees(angle_rad)
    first = min(errors, default=None)
    is_old = first is not None and bool(epochs[first] == old)
    error_m, error_deg = errors[first] if first is not None and is_old else (None, None)
    return RelocalizationOutcome(
        tracked=estimates[FRAMES_BEFORE - 1].ok,
        frames=None if first is None else first - (FRAMES_BEFORE + FRAMES_COVERED) + 1,
        is_old_map=is_old,
        error_m=error_m,
        error_deg=error_deg,
        is_wrong=any(
            distance_m > GROSS_ERROR_M or angle_deg > GROSS_ERROR_DEG
            for distance_m, angle_deg in errors.values()
        ),
    )


def summarize(outcomes: Sequence[RelocalizationOutcome]) -> RelocalizationSummary:
    """Count the outcomes, and summarize the errors in the old map."""
    relocalized = [outcome for outcome in outcomes if outcome.is_old_map]
    waited = [outcome.frames for outcome in relocalized if outcome.frames is not None]
    errors_m = [outcome.error_m for outcome in relocalized if outcome.error_m is not None]
    errors_deg = [outcome.error_deg for outcome in relocalized if outcome.error_deg is not None]
    nowhere = sum(outcome.frames is None for outcome in outcomes)
    return RelocalizationSummary(
        trials=len(outcomes),
        tracked=sum(outcome.tracked for outcome in outcomes),
        old_map=len(relocalized),
        prompt=sum(frames <= MAX_PROMPT_FRAMES for frames in waited),
        new_map=len(outcomes) - len(relocalized) - nowhere,
        nowhere=nowhere,
        wrong=sum(outcome.is_wrong for outcome in outcomes),
        median_frames=float(np.median(waited)) if waited else None,
        median_m=float(np.median(errors_m)) if errors_m else None,
        largest_m=max(errors_m, default=None),
        largest_deg=max(errors_deg, default=None),
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("folder", type=Path, help="folder of rendered frames and results")
    parser.add_argument("--tries", type=int, default=100, help="trials of all seeds together")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2, 3, 4, 5])
    parser.add_argument(
        "--unseen", action="store_true", help="uncover the camera at places that it did not see"
    )
    parser.add_argument("--twins", action="store_true", help="two corners look the same")
    parser.add_argument("--method", choices=METHODS, default="direct")
    parser.add_argument("--alone", action="store_true", help="only the odometry, without a map")
    add_json_option(parser)


def main(args: argparse.Namespace) -> None:
    """Run the seeds without stored results; print all of them, then all together."""
    print_json(args, run(args))


def run(args: argparse.Namespace) -> Mapping[str, RelocalizationSummary]:
    """Results by seed, and together. Raises InputError if the folder cannot be used."""
    args.folder.mkdir(parents=True, exist_ok=True)
    cache = ResultCache(args.folder)
    warm_up(args.method, lambda stage: None)
    results, together = dict[str, RelocalizationSummary](), list[RelocalizationOutcome]()
    print_line = make_printer(args)
    print_line(HEAD)
    for index, seed in enumerate(args.seeds):
        count = args.tries // len(args.seeds) + (index < args.tries % len(args.seeds))
        seen = "unseen" if args.unseen else "seen"
        alone = "-alone" if args.alone else ""
        name = f"{'twins' if args.twins else 'tour'}-{seed}-{seen}-{args.method}{alone}"
        result = cache.get_or_run(f"{name}-{count}", partial(_measure, args, seed, count))
        outcomes = [RelocalizationOutcome(**each) for each in result["outcomes"]]
        together += outcomes
        results[name] = summarize(outcomes)
        print_line(format_row(name, results[name]))
    results["together"] = summarize(together)
    print_line(format_row("together", results["together"]))
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
            _run_trial(
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

"""What becomes of one try: where a camera that was covered says it is, and how wrong that is."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.relocalization_trials import FRAMES_BEFORE, FRAMES_COVERED
from benchmarks.runners import TrajectoryRunner
from drivers.camera import RgbdFrame
from drivers.core.geometry import Array, inverse, pose_distance
from vo_service.tools.evaluation.gross_errors import GROSS_ERROR_DEG, GROSS_ERROR_M
from vo_service.types import Estimate


@dataclass(frozen=True)
class RelocalizationOutcome:
    """One try.

    tracked         whether there was a pose in the frame before the cover
    frames          from the first uncovered frame to the first with a pose, both counted; None:
                    there was none
    is_old_world    that pose goes on in the world from before the cover
    error_m, error_deg  of that pose, in the old world; None in a new one
    is_wrong        a pose after the cover is off by more than 5 cm or 3 degrees: in the old world,
                    or counted from the first pose of its own new world
    """

    tracked: bool
    frames: int | None
    is_old_map: bool
    error_m: float | None
    error_deg: float | None
    is_wrong: bool


@dataclass(frozen=True)
class RelocalizationSummary:
    """All tries together; `prompt` came back into the old world within so many frames."""

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


def run_trial(
    runner: TrajectoryRunner, frames: Iterable[RgbdFrame], T_room_camera: Array, overlap_frame: int
) -> RelocalizationOutcome:
    """Run one try; T_room_camera (F, 4, 4) and `alike` as for `judge`."""
    estimates = []
    for frame in frames:
        estimates.append(runner.estimate_pose(frame))
        runner.update_map()
    return evaluate_trial(estimates, T_room_camera, overlap_frame)


def evaluate_trial(
    estimates: Sequence[Estimate], T_room_camera: Array, overlap_frame: int
) -> RelocalizationOutcome:
    """What the F estimates of a try are worth, by the truth T_room_camera (F, 4, 4).

    Where the old world lies in the room is told by frame `alike` before the cover, which shows
    most of the place that it comes back to: what drifted elsewhere is no error of coming back. A
    new world lies where its first pose says.
    """
    worlds = np.cumsum([estimate.is_reset for estimate in estimates])
    old, errors = worlds[FRAMES_BEFORE - 1], dict[int, tuple[float, float]]()
    known = overlap_frame if worlds[overlap_frame] == old else FRAMES_BEFORE - 1
    T_room_world = {old: T_room_camera[known] @ inverse(estimates[known].T_world_camera)}
    for number in range(FRAMES_BEFORE + FRAMES_COVERED, len(estimates)):
        if estimates[number].ok:
            T_world_camera, T_room = estimates[number].T_world_camera, T_room_camera[number]
            lies = T_room_world.setdefault(worlds[number], T_room @ inverse(T_world_camera))
            off_m, off_rad = pose_distance(T_room, lies @ T_world_camera)
            errors[number] = off_m, math.degrees(off_rad)
    first = min(errors, default=None)
    is_old = first is not None and bool(worlds[first] == old)
    error_m, error_deg = errors[first] if first is not None and is_old else (None, None)
    return RelocalizationOutcome(
        tracked=estimates[FRAMES_BEFORE - 1].ok,
        frames=None if first is None else first - (FRAMES_BEFORE + FRAMES_COVERED) + 1,
        is_old_map=is_old,
        error_m=error_m,
        error_deg=error_deg,
        is_wrong=any(
            off_m > GROSS_ERROR_M or off_deg > GROSS_ERROR_DEG for off_m, off_deg in errors.values()
        ),
    )


def summarize(outcomes: Sequence[RelocalizationOutcome]) -> RelocalizationSummary:
    """Counts, and errors of those that came back."""
    back = [outcome for outcome in outcomes if outcome.is_old_map]
    waited = [outcome.frames for outcome in back if outcome.frames is not None]
    errors_m = [outcome.error_m for outcome in back if outcome.error_m is not None]
    errors_deg = [outcome.error_deg for outcome in back if outcome.error_deg is not None]
    nowhere = sum(outcome.frames is None for outcome in outcomes)
    return RelocalizationSummary(
        trials=len(outcomes),
        tracked=sum(outcome.tracked for outcome in outcomes),
        old_map=len(back),
        prompt=sum(frames <= MAX_PROMPT_FRAMES for frames in waited),
        new_map=len(outcomes) - len(back) - nowhere,
        nowhere=nowhere,
        wrong=sum(outcome.is_wrong for outcome in outcomes),
        median_frames=float(np.median(waited)) if waited else None,
        median_m=float(np.median(errors_m)) if errors_m else None,
        largest_m=max(errors_m, default=None),
        largest_deg=max(errors_deg, default=None),
    )

"""Evaluation of a relocalization trial: the poses after the cover, and their errors."""

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


def run_trial(
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

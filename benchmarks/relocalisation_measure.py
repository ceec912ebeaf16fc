"""What becomes of one try: where a camera that was covered says it is, and how wrong that is."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.relocalisation_tries import BEFORE, COVERED
from benchmarks.runners import Runner
from benchmarks.tour_measure import apart
from drivers.camera import RgbdFrame
from drivers.errors import InputError
from drivers.geometry import Array, inverse
from drivers.trajectory import StampedPoses
from vo_service.evaluation.association import associate
from vo_service.evaluation.gross_errors import GROSS_DEG, GROSS_M
from vo_service.evaluation.metrics import best_alignment
from vo_service.odometry.estimate import Estimate


@dataclass(frozen=True)
class Outcome:
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
    is_old_world: bool
    error_m: float | None
    error_deg: float | None
    is_wrong: bool


@dataclass(frozen=True)
class Summary:
    """All tries together; `in_time` came back into the old world within so many frames."""

    tries: int
    tracked: int
    old_world: int
    in_time: int
    new_world: int
    nowhere: int
    wrong: int
    median_frames: float | None
    median_m: float | None
    largest_m: float | None
    largest_deg: float | None


IN_TIME = 30


def attempt(runner: Runner, frames: Iterable[RgbdFrame], T_room_camera: Array) -> Outcome:
    """Run one try. T_room_camera (F, 4, 4): the truth at each of its frames."""
    estimates = [runner.frame(frame) for frame in frames]
    return judge(estimates, T_room_camera)


def judge(estimates: Sequence[Estimate], T_room_camera: Array) -> Outcome:
    """What the estimates of a try are worth."""
    worlds = np.cumsum([estimate.restarted for estimate in estimates])
    old = worlds[BEFORE - 1]
    # Where each world lies in the room: the old one by its whole way, a new one by its first pose.
    T_room_world = {int(old): _laid_on_truth(estimates, T_room_camera, worlds == old)}
    first, is_wrong = None, False
    for number in range(BEFORE + COVERED, len(estimates)):
        if not estimates[number].ok:
            continue
        first = number if first is None else first
        T_world_camera, world = estimates[number].T_world_camera, int(worlds[number])
        T_room_world.setdefault(world, T_room_camera[number] @ inverse(T_world_camera))
        off_m, off_deg = apart(T_room_camera[number], T_room_world[world] @ T_world_camera)
        is_wrong |= off_m > GROSS_M or off_deg > GROSS_DEG
    tracked = estimates[BEFORE - 1].ok
    if first is None:
        return Outcome(tracked, None, False, None, None, False)
    waited = first - (BEFORE + COVERED) + 1
    if worlds[first] != old:
        return Outcome(tracked, waited, False, None, None, is_wrong)
    there = T_room_world[int(old)] @ estimates[first].T_world_camera
    return Outcome(tracked, waited, True, *apart(T_room_camera[first], there), is_wrong)


def _laid_on_truth(estimates: Sequence[Estimate], T_room_camera: Array, is_old: Array) -> Array:
    """T_room_world of the world before the cover."""
    numbers = [n for n in range(BEFORE) if is_old[n] and estimates[n].ok]
    poses = np.array([estimates[n].T_world_camera for n in numbers]).reshape(-1, 4, 4)
    stamps_s = np.array(numbers, np.float64)
    try:
        matched = associate(
            StampedPoses(stamps_s, poses), StampedPoses(stamps_s, T_room_camera[numbers])
        )
    except InputError:
        # A world that hardly began: nothing can be said of it but by its last pose.
        T_room_world: Array = T_room_camera[BEFORE - 1] @ inverse(
            estimates[BEFORE - 1].T_world_camera
        )
        return T_room_world
    return best_alignment(matched)


def summary(outcomes: Sequence[Outcome]) -> Summary:
    """Counts, and errors of those that came back."""
    back = [outcome for outcome in outcomes if outcome.is_old_world]
    waited = [outcome.frames for outcome in back if outcome.frames is not None]
    errors_m = [outcome.error_m for outcome in back if outcome.error_m is not None]
    errors_deg = [outcome.error_deg for outcome in back if outcome.error_deg is not None]
    nowhere = sum(outcome.frames is None for outcome in outcomes)
    return Summary(
        tries=len(outcomes),
        tracked=sum(outcome.tracked for outcome in outcomes),
        old_world=len(back),
        in_time=sum(frames <= IN_TIME for frames in waited),
        new_world=len(outcomes) - len(back) - nowhere,
        nowhere=nowhere,
        wrong=sum(outcome.is_wrong for outcome in outcomes),
        median_frames=float(np.median(waited)) if waited else None,
        median_m=float(np.median(errors_m)) if errors_m else None,
        largest_m=max(errors_m, default=None),
        largest_deg=max(errors_deg, default=None),
    )

"""How well places are recognised: how often, how exactly, at what cost; and never wrongly.

    python -m benchmarks.place_recognition [--rooms 201 202 ...] [--recordings FOLDER...]

Each room is another one of the virtual Kinect, seen from a few spots, with views around each; a
recording has a view every half second, and a ground truth. Every view is a place as well, and every
view is held against every other place, of its own room and of all others. A recognition is wrong if
it is off by more than 5 cm or 3 degrees, or of another room.
"""

import argparse
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np

from benchmarks.relocalization_views import (
    VIEW_OFFSETS,
    PosedView,
    views_of_recording,
    views_of_room,
)
from drivers.core.errors import UserFacingError
from drivers.core.geometry import Array, inverse, rotation_angle_rad
from vo_service.odometry.direct.se3 import se3_log
from vo_service.slam.place_recognition.keyframe_database import KeyframeDatabase
from vo_service.slam.place_recognition.map_keyframe import MapKeyframe
from vo_service.slam.place_recognition.place_recognizer import PlaceRecognizer
from vo_service.slam.place_recognition.query_frame import (
    LOST_VELOCITY_SIGMA,
    TRACKED_VELOCITY_SIGMA,
    QueryFrame,
)

MAX_ERROR_M, MAX_ERROR_DEG = 0.05, 3.0
HEADING = "apart | tries | sighted | recognised | mm | 95 % | worst | degrees | sigmas | wrong"
# So many places are asked for what looks alike.
TOP_RANKS = (1, 3, 5, 10)
Result = TypeVar("Result")


@dataclass(frozen=True)
class DescribedView:
    """A glance as the map looks at it: with its velocity about known, without, and as a place."""

    posed_view: PosedView
    query: QueryFrame
    query_without_velocity: QueryFrame
    keyframe: MapKeyframe


@dataclass(frozen=True)
class RecognitionTrial:
    """One view held against one place: where it is truly, and what was recognised.

    metres, degrees  how far apart they are; infinite in different scenes
    off_m, off_deg   how wrong the recognition is; None without one
    surprise         its error in standard deviations, root mean square of six directions
    """

    metres: float
    degrees: float
    is_candidate: bool
    error_m: float | None = None
    error_deg: float = 0.0
    normalized_error: float = 0.0

    @property
    def is_wrong(self) -> bool:
        return self.error_m is not None and (
            self.error_m > MAX_ERROR_M or self.error_deg > MAX_ERROR_DEG
        )

    def is_within(self, metres: float, degrees: float) -> bool:
        return self.metres <= 1.01 * metres and self.degrees <= 1.01 * degrees


class CpuTimer:
    """Processor time, by what it went to."""

    def __init__(self) -> None:
        self.times_ms: dict[str, list[float]] = {}

    def measure(self, what: str, work: Callable[[], Result]) -> Result:
        begin_s = time.process_time()
        result = work()
        self.times_ms.setdefault(what, []).append(1e3 * (time.process_time() - begin_s))
        return result


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.place_recognition",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rooms", nargs="*", type=int, default=list(range(201, 207)))
    parser.add_argument("--recordings", nargs="*", type=Path, default=[])
    args = parser.parse_args()
    watch, recogniser = CpuTimer(), PlaceRecognizer()
    scenes = chain(map(views_of_room, args.rooms), map(views_of_recording, args.recordings))
    seen: list[DescribedView] = []
    try:
        for scene in scenes:
            seen += [
                _describe_view(recogniser, glance, watch, len(seen) + n)
                for n, glance in enumerate(scene)
            ]
            print(f"looked at {seen[-1].posed_view.scene}", file=sys.stderr, flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    _print_trials("velocity followed", _run_trials(recogniser, seen, lambda s: s.query, watch))
    _print_trials(
        "velocity unknown", _run_trials(recogniser, seen, lambda s: s.query_without_velocity, watch)
    )
    _print_ranking(seen, watch)
    for what, times_ms in watch.times_ms.items():
        print(
            f"{what}: {np.median(times_ms):.2f} ms of CPU, 99 % {np.percentile(times_ms, 99):.2f}"
        )
    sizes = [each.keyframe.size_bytes / 1e3 for each in seen]
    print(f"a place: {np.mean(sizes):.0f} kB, at most {np.max(sizes):.0f}")
    return 0


def _describe_view(
    recogniser: PlaceRecognizer, glance: PosedView, watch: CpuTimer, number: int
) -> DescribedView:
    """The velocity as the odometry would give it, and as it is after a loss."""
    frame, sigma = glance.frame, np.repeat(TRACKED_VELOCITY_SIGMA, 3)
    velocity = glance.velocity + sigma * np.random.default_rng([3, number]).normal(size=6)
    view = watch.measure("view", lambda: recogniser.create_query(frame, velocity))
    lost = recogniser.create_query(frame, np.zeros(6), LOST_VELOCITY_SIGMA)
    T = glance.T_world_camera
    place = watch.measure("place", lambda: recogniser.create_keyframe(view, number, 0, T))
    return DescribedView(glance, view, lost, place)


def _run_trials(
    recogniser: PlaceRecognizer,
    seen: Sequence[DescribedView],
    of: Callable[[DescribedView], QueryFrame],
    watch: CpuTimer,
) -> list[RecognitionTrial]:
    """Every view against every other place."""
    return [
        _run_trial(recogniser, a.posed_view, of(a), b, watch)
        for a in seen
        for b in seen
        if a is not b
    ]


def _run_trial(
    recogniser: PlaceRecognizer,
    glance: PosedView,
    view: QueryFrame,
    other: DescribedView,
    watch: CpuTimer,
) -> RecognitionTrial:
    T, metres, degrees = np.eye(4), np.inf, np.inf
    if glance.scene == other.posed_view.scene:
        T = inverse(other.posed_view.T_world_camera) @ glance.T_world_camera
        metres, degrees = _size(T)
    sightings = watch.measure(
        "sighting", lambda: list(recogniser.find_candidates(view, [other.keyframe]))
    )
    if not sightings:
        return RecognitionTrial(metres, degrees, is_candidate=False)
    found = watch.measure("confirmation", lambda: recogniser.verify(view, sightings[0]))
    if found is None:
        return RecognitionTrial(metres, degrees, is_candidate=True)
    if np.isinf(metres):
        return RecognitionTrial(metres, degrees, True, np.inf, np.inf, np.inf)
    error = inverse(T) @ found.T_keyframe_camera
    twist = se3_log(error)
    surprise = float(np.sqrt(twist @ np.linalg.solve(found.covariance, twist) / 6.0))
    return RecognitionTrial(metres, degrees, True, *_size(error), surprise)


def _size(T: Array) -> tuple[float, float]:
    """Metres and degrees of a motion."""
    return float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle_rad(T[:3, :3])))


def _print_trials(title: str, tries: Sequence[RecognitionTrial]) -> None:
    print(f"\n{title}\n{HEADING}")
    rest = list(tries)
    for step in VIEW_OFFSETS:
        chosen = [each for each in rest if each.is_within(*step)]
        rest = [each for each in rest if not each.is_within(*step)]
        _print_row(f"to {step[0]:g} m, {step[1]:g} deg", chosen)
    _print_row("further", [each for each in rest if np.isfinite(each.metres)])
    _print_row("another scene", [each for each in rest if np.isinf(each.metres)])


def _print_row(name: str, tries: Sequence[RecognitionTrial]) -> None:
    known = [each for each in tries if each.error_m is not None]
    row = [name, len(tries), sum(each.is_candidate for each in tries), len(known)]
    off_mm = np.array([1e3 * (each.error_m or 0.0) for each in known])
    if len(known):
        row += [f"{value:.1f}" for value in (*np.percentile(off_mm, [50, 95]), off_mm.max())]
        row.append(f"{np.median([each.error_deg for each in known]):.3f}")
        row.append(f"{np.percentile([each.normalized_error for each in known], 95):.1f}")
    else:
        row += ["-"] * 5
    print(" | ".join(map(str, [*row, sum(each.is_wrong for each in known)])))


def _print_ranking(seen: Sequence[DescribedView], watch: CpuTimer) -> None:
    """How often a place within the third step is among those that look most alike."""
    places = KeyframeDatabase(sum(each.keyframe.size_bytes for each in seen))
    for each in seen:
        places.add(each.keyframe)
    ranks = [rank for each in seen for rank in _rank_of_nearest(places, each, seen, watch)]
    shares = [f"{100 * np.mean(np.array(ranks) < most):.1f} % among {most}" for most in TOP_RANKS]
    print(f"\nof {len(places)} places, one that is near looks alike: {', '.join(shares)}")


def _rank_of_nearest(
    places: KeyframeDatabase, each: DescribedView, seen: Sequence[DescribedView], watch: CpuTimer
) -> Iterable[int]:
    """How many places look more alike than the first one that is near, where there is one."""
    others = [other.keyframe.number for other in seen if _is_near(each, other)]
    if not others:
        return
    mine = each.keyframe.number
    alike = watch.measure(
        "search",
        lambda: places.find_similar(each.query, len(places), lambda place: place.number != mine),
    )
    yield next(rank for rank, place in enumerate(alike) if place.number in others)


def _is_near(a: DescribedView, b: DescribedView) -> bool:
    if a is b or a.posed_view.scene != b.posed_view.scene:
        return False
    metres, degrees = _size(inverse(a.posed_view.T_world_camera) @ b.posed_view.T_world_camera)
    return RecognitionTrial(metres, degrees, False).is_within(*VIEW_OFFSETS[2])


if __name__ == "__main__":
    sys.exit(main())

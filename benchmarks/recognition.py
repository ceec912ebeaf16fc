"""How well places are recognised: how often, how exactly, at what cost; and never wrongly.

    python -m benchmarks.recognition [--rooms 201 202 ...] [--recordings FOLDER...]

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

from benchmarks.glances import STEPS, Glance, of_recording, of_room
from drivers.errors import UserFacingError
from drivers.geometry import Array, inverse, rotation_angle_rad
from vo_service.mapping.places.place import Place
from vo_service.mapping.places.places import Places
from vo_service.mapping.places.recognition import Recogniser
from vo_service.mapping.places.view import FOLLOWED, LOST, PlaceView
from vo_service.odometry.keyframe.twists import logarithm

WRONG_M, WRONG_DEG = 0.05, 3.0
HEADING = "apart | tries | sighted | recognised | mm | 95 % | worst | degrees | sigmas | wrong"
# So many places are asked for what looks alike.
MOST_ALIKE = (1, 3, 5, 10)
Result = TypeVar("Result")


@dataclass(frozen=True)
class Seen:
    """A glance as the map looks at it: with its velocity about known, without, and as a place."""

    glance: Glance
    view: PlaceView
    lost: PlaceView
    place: Place


@dataclass(frozen=True)
class Try:
    """One view held against one place: where it is truly, and what was recognised.

    metres, degrees  how far apart they are; infinite in different scenes
    off_m, off_deg   how wrong the recognition is; None without one
    surprise         its error in standard deviations, root mean square of six directions
    """

    metres: float
    degrees: float
    sighted: bool
    off_m: float | None = None
    off_deg: float = 0.0
    surprise: float = 0.0

    @property
    def is_wrong(self) -> bool:
        return self.off_m is not None and (self.off_m > WRONG_M or self.off_deg > WRONG_DEG)

    def is_within(self, metres: float, degrees: float) -> bool:
        return self.metres <= 1.01 * metres and self.degrees <= 1.01 * degrees


class Stopwatch:
    """Processor time, by what it went to."""

    def __init__(self) -> None:
        self.times_ms: dict[str, list[float]] = {}

    def time(self, what: str, work: Callable[[], Result]) -> Result:
        begin_s = time.process_time()
        result = work()
        self.times_ms.setdefault(what, []).append(1e3 * (time.process_time() - begin_s))
        return result


def main() -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.recognition",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--rooms", nargs="*", type=int, default=list(range(201, 207)))
    parser.add_argument("--recordings", nargs="*", type=Path, default=[])
    args = parser.parse_args()
    watch, recogniser = Stopwatch(), Recogniser()
    scenes = chain(map(of_room, args.rooms), map(of_recording, args.recordings))
    seen: list[Seen] = []
    try:
        for scene in scenes:
            seen += [
                _look(recogniser, glance, watch, len(seen) + n) for n, glance in enumerate(scene)
            ]
            print(f"looked at {seen[-1].glance.scene}", file=sys.stderr, flush=True)
    except UserFacingError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code
    _tell_tries("velocity followed", _tries(recogniser, seen, lambda s: s.view, watch))
    _tell_tries("velocity unknown", _tries(recogniser, seen, lambda s: s.lost, watch))
    _tell_alike(seen, watch)
    for what, times_ms in watch.times_ms.items():
        print(
            f"{what}: {np.median(times_ms):.2f} ms of CPU, 99 % {np.percentile(times_ms, 99):.2f}"
        )
    sizes = [each.place.bytes / 1e3 for each in seen]
    print(f"a place: {np.mean(sizes):.0f} kB, at most {np.max(sizes):.0f}")
    return 0


def _look(recogniser: Recogniser, glance: Glance, watch: Stopwatch, number: int) -> Seen:
    """The velocity as the odometry would give it, and as it is after a loss."""
    frame, sigma = glance.frame, np.repeat(FOLLOWED, 3)
    velocity = glance.velocity + sigma * np.random.default_rng([3, number]).normal(size=6)
    view = watch.time("view", lambda: recogniser.view(frame, velocity))
    lost = recogniser.view(frame, np.zeros(6), LOST)
    T = glance.T_world_camera
    place = watch.time("place", lambda: recogniser.place(view, number, 0, T))
    return Seen(glance, view, lost, place)


def _tries(
    recogniser: Recogniser, seen: Sequence[Seen], of: Callable[[Seen], PlaceView], watch: Stopwatch
) -> list[Try]:
    """Every view against every other place."""
    return [_try(recogniser, a.glance, of(a), b, watch) for a in seen for b in seen if a is not b]


def _try(
    recogniser: Recogniser, glance: Glance, view: PlaceView, other: Seen, watch: Stopwatch
) -> Try:
    T, metres, degrees = np.eye(4), np.inf, np.inf
    if glance.scene == other.glance.scene:
        T = inverse(other.glance.T_world_camera) @ glance.T_world_camera
        metres, degrees = _size(T)
    sightings = watch.time("sighting", lambda: list(recogniser.sightings(view, [other.place])))
    if not sightings:
        return Try(metres, degrees, sighted=False)
    found = watch.time("confirmation", lambda: recogniser.confirm(view, sightings[0]))
    if found is None:
        return Try(metres, degrees, sighted=True)
    if np.isinf(metres):
        return Try(metres, degrees, True, np.inf, np.inf, np.inf)
    error = inverse(T) @ found.T_place_camera
    twist = logarithm(error)
    surprise = float(np.sqrt(twist @ np.linalg.solve(found.covariance, twist) / 6.0))
    return Try(metres, degrees, True, *_size(error), surprise)


def _size(T: Array) -> tuple[float, float]:
    """Metres and degrees of a motion."""
    return float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle_rad(T[:3, :3])))


def _tell_tries(title: str, tries: Sequence[Try]) -> None:
    print(f"\n{title}\n{HEADING}")
    rest = list(tries)
    for step in STEPS:
        chosen = [each for each in rest if each.is_within(*step)]
        rest = [each for each in rest if not each.is_within(*step)]
        _tell_row(f"to {step[0]:g} m, {step[1]:g} deg", chosen)
    _tell_row("further", [each for each in rest if np.isfinite(each.metres)])
    _tell_row("another scene", [each for each in rest if np.isinf(each.metres)])


def _tell_row(name: str, tries: Sequence[Try]) -> None:
    known = [each for each in tries if each.off_m is not None]
    row = [name, len(tries), sum(each.sighted for each in tries), len(known)]
    off_mm = np.array([1e3 * (each.off_m or 0.0) for each in known])
    if len(known):
        row += [f"{value:.1f}" for value in (*np.percentile(off_mm, [50, 95]), off_mm.max())]
        row.append(f"{np.median([each.off_deg for each in known]):.3f}")
        row.append(f"{np.percentile([each.surprise for each in known], 95):.1f}")
    else:
        row += ["-"] * 5
    print(" | ".join(map(str, [*row, sum(each.is_wrong for each in known)])))


def _tell_alike(seen: Sequence[Seen], watch: Stopwatch) -> None:
    """How often a place within the third step is among those that look most alike."""
    places = Places(sum(each.place.bytes for each in seen))
    for each in seen:
        places.add(each.place)
    ranks = [rank for each in seen for rank in _rank(places, each, seen, watch)]
    shares = [f"{100 * np.mean(np.array(ranks) < most):.1f} % among {most}" for most in MOST_ALIKE]
    print(f"\nof {len(places)} places, one that is near looks alike: {', '.join(shares)}")


def _rank(places: Places, each: Seen, seen: Sequence[Seen], watch: Stopwatch) -> Iterable[int]:
    """How many places look more alike than the first one that is near, where there is one."""
    others = [other.place.number for other in seen if _is_near(each, other)]
    if not others:
        return
    mine = each.place.number
    alike = watch.time(
        "search", lambda: places.alike(each.view, len(places), lambda place: place.number != mine)
    )
    yield next(rank for rank, place in enumerate(alike) if place.number in others)


def _is_near(a: Seen, b: Seen) -> bool:
    if a is b or a.glance.scene != b.glance.scene:
        return False
    metres, degrees = _size(inverse(a.glance.T_world_camera) @ b.glance.T_world_camera)
    return Try(metres, degrees, False).is_within(*STEPS[2])


if __name__ == "__main__":
    sys.exit(main())

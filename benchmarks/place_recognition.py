"""Place recognition: recall, accuracy, cost and false matches.

    python -m benchmarks place_recognition [--rooms 201 202 ...] [--recordings FOLDER...]

Each room is a room of the virtual Kinect with views around a few spots. A recording has a view
every half second, and a ground truth. Every view is also a keyframe, and every view is matched with
every other keyframe of all scenes. A match is wrong if its error is above 5 cm or 3 degrees, or if
it is of another scene.
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

from benchmarks.rendered_views import (
    VIEW_OFFSETS,
    PosedView,
    views_of_recording,
    views_of_room,
)
from drivers.core.geometry import Array, inverse, rotation_angle_rad
from vo_service.odometry.direct.motion import se3_log
from vo_service.slam.keyframe_database import (
    LOST_VELOCITY_SIGMA,
    TRACKED_VELOCITY_SIGMA,
    KeyframeDatabase,
    MapKeyframe,
    QueryFrame,
)
from vo_service.slam.place_recognizer import PlaceRecognizer

MAX_ERROR_M, MAX_ERROR_DEG = 0.05, 3.0
HEADING = "distance | trials | candidates | verified | mm | 95 % | max | degrees | sigmas | wrong"
# Numbers of most similar keyframes that the ranking checks.
TOP_RANKS = (1, 3, 5, 10)
Result = TypeVar("Result")


@dataclass(frozen=True)
class DescribedView:
    """A view as a query, with and without a verified velocity, and as a keyframe."""

    posed_view: PosedView
    query: QueryFrame
    query_without_velocity: QueryFrame
    keyframe: MapKeyframe


@dataclass(frozen=True)
class RecognitionTrial:
    """Result of matching one view with one keyframe.

    Attributes:
        distance_m: True distance of the poses; infinite in different scenes.
        angle_deg: True angle between the poses.
        is_candidate: Whether the keyframe was a candidate.
        error_m: Position error of the match; None without a match.
        error_deg: Rotation error of the match.
        normalized_error: Error in standard deviations, RMS over six directions.
    """

    distance_m: float
    angle_deg: float
    is_candidate: bool
    error_m: float | None = None
    error_deg: float = 0.0
    normalized_error: float = 0.0

    @property
    def is_wrong(self) -> bool:
        return self.error_m is not None and (
            self.error_m > MAX_ERROR_M or self.error_deg > MAX_ERROR_DEG
        )

    def is_within(self, distance_m: float, angle_deg: float) -> bool:
        return self.distance_m <= 1.01 * distance_m and self.angle_deg <= 1.01 * angle_deg


class CpuTimer:
    """Processor time by task."""

    def __init__(self) -> None:
        self.times_ms: dict[str, list[float]] = {}

    def measure(self, what: str, work: Callable[[], Result]) -> Result:
        begin_s = time.process_time()
        result = work()
        self.times_ms.setdefault(what, []).append(1e3 * (time.process_time() - begin_s))
        return result


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("--rooms", nargs="*", type=int, default=list(range(201, 207)))
    parser.add_argument("--recordings", nargs="*", type=Path, default=[])


def main(args: argparse.Namespace) -> None:
    """Measure and print."""
    timer, recognizer = CpuTimer(), PlaceRecognizer()
    scenes = chain(map(views_of_room, args.rooms), map(views_of_recording, args.recordings))
    views: list[DescribedView] = []
    for scene in scenes:
        views += [
            _describe_view(recognizer, view, timer, len(views) + n) for n, view in enumerate(scene)
        ]
        print(f"described {views[-1].posed_view.scene}", file=sys.stderr, flush=True)
    _print_trials("velocity followed", _run_trials(recognizer, views, lambda s: s.query, timer))
    _print_trials(
        "velocity unknown",
        _run_trials(recognizer, views, lambda s: s.query_without_velocity, timer),
    )
    _print_ranking(views, timer)
    for task, times_ms in timer.times_ms.items():
        print(
            f"{task}: {np.median(times_ms):.2f} ms of CPU, 99 % {np.percentile(times_ms, 99):.2f}"
        )
    sizes = [each.keyframe.size_bytes / 1e3 for each in views]
    print(f"a keyframe: {np.mean(sizes):.0f} kB, at most {np.max(sizes):.0f}")


def _describe_view(
    recognizer: PlaceRecognizer, posed_view: PosedView, timer: CpuTimer, number: int
) -> DescribedView:
    """Describe a view with the velocity of the odometry, and with that after a loss."""
    frame, sigma = posed_view.frame, np.repeat(TRACKED_VELOCITY_SIGMA, 3)
    velocity = posed_view.velocity + sigma * np.random.default_rng([3, number]).normal(size=6)
    query = timer.measure("query", lambda: recognizer.create_query(frame, velocity))
    lost = recognizer.create_query(frame, np.zeros(6), LOST_VELOCITY_SIGMA)
    T = posed_view.T_world_camera
    keyframe = timer.measure("keyframe", lambda: recognizer.create_keyframe(query, number, 0, T))
    return DescribedView(posed_view, query, lost, keyframe)


def _run_trials(
    recognizer: PlaceRecognizer,
    views: Sequence[DescribedView],
    query_of: Callable[[DescribedView], QueryFrame],
    timer: CpuTimer,
) -> list[RecognitionTrial]:
    """Match every view with every other keyframe."""
    return [
        _run_trial(recognizer, a.posed_view, query_of(a), b, timer)
        for a in views
        for b in views
        if a is not b
    ]


def _run_trial(
    recognizer: PlaceRecognizer,
    posed_view: PosedView,
    query: QueryFrame,
    other: DescribedView,
    timer: CpuTimer,
) -> RecognitionTrial:
    T, distance_m, angle_deg = np.eye(4), np.inf, np.inf
    if posed_view.scene == other.posed_view.scene:
        T = inverse(other.posed_view.T_world_camera) @ posed_view.T_world_camera
        distance_m, angle_deg = _size(T)
    candidates = timer.measure(
        "candidates", lambda: list(recognizer.find_candidates(query, [other.keyframe]))
    )
    if not candidates:
        return RecognitionTrial(distance_m, angle_deg, is_candidate=False)
    match = timer.measure("verification", lambda: recognizer.verify(query, candidates[0]))
    if match is None:
        return RecognitionTrial(distance_m, angle_deg, is_candidate=True)
    if np.isinf(distance_m):
        return RecognitionTrial(distance_m, angle_deg, True, np.inf, np.inf, np.inf)
    error = inverse(T) @ match.T_keyframe_camera
    twist = se3_log(error)
    normalized_error = float(np.sqrt(twist @ np.linalg.solve(match.covariance, twist) / 6.0))
    return RecognitionTrial(distance_m, angle_deg, True, *_size(error), normalized_error)


def _size(T: Array) -> tuple[float, float]:
    """Distance in meters and angle in degrees of a motion."""
    return float(np.linalg.norm(T[:3, 3])), float(np.degrees(rotation_angle_rad(T[:3, :3])))


def _print_trials(title: str, trials: Sequence[RecognitionTrial]) -> None:
    print(f"\n{title}\n{HEADING}")
    rest = list(trials)
    for step in VIEW_OFFSETS:
        chosen = [each for each in rest if each.is_within(*step)]
        rest = [each for each in rest if not each.is_within(*step)]
        _print_row(f"to {step[0]:g} m, {step[1]:g} deg", chosen)
    _print_row("further", [each for each in rest if np.isfinite(each.distance_m)])
    _print_row("another scene", [each for each in rest if np.isinf(each.distance_m)])


def _print_row(name: str, trials: Sequence[RecognitionTrial]) -> None:
    verified = [each for each in trials if each.error_m is not None]
    row = [name, len(trials), sum(each.is_candidate for each in trials), len(verified)]
    error_mm = np.array([1e3 * (each.error_m or 0.0) for each in verified])
    if len(verified):
        row += [f"{value:.1f}" for value in (*np.percentile(error_mm, [50, 95]), error_mm.max())]
        row.append(f"{np.median([each.error_deg for each in verified]):.3f}")
        row.append(f"{np.percentile([each.normalized_error for each in verified], 95):.1f}")
    else:
        row += ["-"] * 5
    print(" | ".join(map(str, [*row, sum(each.is_wrong for each in verified)])))


def _print_ranking(views: Sequence[DescribedView], timer: CpuTimer) -> None:
    """Print how often a keyframe within the third step is among the most similar ones."""
    database = KeyframeDatabase(sum(each.keyframe.size_bytes for each in views))
    for each in views:
        database.add(each.keyframe)
    ranks = [rank for each in views for rank in _rank_of_nearest(database, each, views, timer)]
    shares = [f"{100 * np.mean(np.array(ranks) < most):.1f} % among {most}" for most in TOP_RANKS]
    print(f"\nof {len(database)} keyframes, a near one is similar: {', '.join(shares)}")


def _rank_of_nearest(
    database: KeyframeDatabase, each: DescribedView, views: Sequence[DescribedView], timer: CpuTimer
) -> Iterable[int]:
    """Yield the number of keyframes more similar than the first near one, if there is one."""
    others = [other.keyframe.number for other in views if _is_near(each, other)]
    if not others:
        return
    number = each.keyframe.number
    similar = timer.measure(
        "search",
        lambda: database.find_similar(each.query, len(database), lambda k: k.number != number),
    )
    yield next(rank for rank, keyframe in enumerate(similar) if keyframe.number in others)


def _is_near(a: DescribedView, b: DescribedView) -> bool:
    if a is b or a.posed_view.scene != b.posed_view.scene:
        return False
    distance_m, angle_deg = _size(
        inverse(a.posed_view.T_world_camera) @ b.posed_view.T_world_camera
    )
    return RecognitionTrial(distance_m, angle_deg, False).is_within(*VIEW_OFFSETS[2])
